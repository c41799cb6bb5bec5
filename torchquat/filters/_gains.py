"""Gains of a Kalman filter and of its backward pass, for motion along one axis.

All three axes of a rotation share them: they depend on which frames are seen and how far each is
trusted, not on what is seen. Entries of matrices are numbers, or tensors ``(..., J)`` in float64.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["PROCESS", "TRANSITION", "Gains", "gains"]

Entry = float | Tensor
Vector = list[Entry]
Matrix = list[list[Entry]]

TRANSITION: dict[int, list[list[float]]] = {
    2: [[1.0, 1.0], [0.0, 1.0]],
    3: [[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]],
}
"""One frame of constant velocity, or of constant acceleration."""

PROCESS: dict[int, list[list[float]]] = {
    2: [[1 / 3, 1 / 2], [1 / 2, 1.0]],
    3: [[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]],
}
"""Covariance that white noise in the highest derivative has made after one frame."""

DIFFUSE = 1e7
"""Variance of the state before anything is seen, in units of the measurement's."""


class Gains(NamedTuple):
    """Of a sequence of T frames.

    Attributes:
        forward: What each derivative is moved by per radian of surprise, one list a frame.
        backward: What the frame after corrects in each frame, one matrix a frame but the last.
    """

    forward: list[Vector]
    backward: list[Matrix]


def gains(trusts: Sequence[Entry], ratio: Entry, order: int) -> Gains:
    """Gains for frames that are trusted so much.

    Args:
        trusts: One over the variance of each measurement, in units of a common one; 0: not seen.
        ratio: Variance of the process noise in these units.
        order: How many derivatives the state has, the rotation itself counted: 2 or 3.
    """
    step, process = TRANSITION[order], PROCESS[order]
    # tensors throughout, or numbers throughout: a number over a tensor is rounded differently
    prior = DIFFUSE * (1.0 + ratio) + 0.0 * trusts[0]
    start: Matrix = [[prior if a == b else 0.0 * prior for b in range(order)] for a in range(order)]
    forward, filtered, predicted = [], [], []
    started: Tensor | None = None
    ahead = start
    for trust in trusts:
        if filtered:
            ahead = _carried(filtered[-1], step, process, ratio)
        if isinstance(trust, Tensor):
            # nothing is known and nothing moves before the first frame that is seen
            if started is not None:
                ahead = _where(started, ahead, start)
            started = trust > 0 if started is None else started | (trust > 0)
        predicted.append(ahead)
        share = trust / (1.0 + trust * ahead[0][0])
        forward.append([share * row[0] for row in ahead])
        filtered.append(_seen(ahead, trust))
    backward = [
        _smoothing(known, expected, step)
        for known, expected in zip(filtered[:-1], predicted[1:], strict=True)
    ]
    return Gains(forward, backward)


def _carried(
    p: Matrix, step: list[list[float]], process: list[list[float]], ratio: Entry
) -> Matrix:
    """Covariance one frame later, ``F P F' + ratio Q``."""
    half = _times_transposed(p, step)
    n = range(len(p))
    return [
        [_sum(step[a][k] * half[k][b] for k in n if step[a][k]) + ratio * process[a][b] for b in n]
        for a in n
    ]


def _seen(p: Matrix, trust: Entry) -> Matrix:
    """Covariance after a measurement of the rotation."""
    total = 1.0 + trust * p[0][0]
    n = range(len(p))
    return [
        [
            # the same number as below, without a difference
            p[a][b] / total if a == 0 or b == 0 else p[a][b] - trust * p[a][0] * p[b][0] / total
            for b in n
        ]
        for a in n
    ]


def _smoothing(known: Matrix, expected: Matrix, step: list[list[float]]) -> Matrix:
    """``P F' E^-1`` with the covariance P of what is known and E of what is expected next."""
    return [_solved(expected, row) for row in _times_transposed(known, step)]


def _times_transposed(p: Matrix, step: list[list[float]]) -> Matrix:
    n = range(len(p))
    return [[_sum(p[a][k] * step[b][k] for k in n if step[b][k]) for b in n] for a in n]


def _solved(matrix: Matrix, right: Vector) -> Vector:
    """Solution of a symmetric positive definite system, by elimination."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    n = len(rows)
    for pivot in range(n):
        for below in range(pivot + 1, n):
            factor = rows[below][pivot] / rows[pivot][pivot]
            rows[below] = [x - factor * y for x, y in zip(rows[below], rows[pivot], strict=True)]
    result: Vector = [0.0] * n
    for a in reversed(range(n)):
        rest = rows[a][n]
        for b in range(a + 1, n):
            rest = rest - rows[a][b] * result[b]
        result[a] = rest / rows[a][a]
    return result


def _where(condition: Tensor, p: Matrix, other: Matrix) -> Matrix:
    return [
        [torch.where(condition, x, y) for x, y in zip(row, row_of_other, strict=True)]
        for row, row_of_other in zip(p, other, strict=True)
    ]


def _sum(terms: Iterable[Entry]) -> Entry:
    first, *rest = terms
    for term in rest:
        first = first + term
    return first
