"""High differences of rotations: in them, motion fades and noise stays."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import _planes, so3
from torchquat._eager import visible

__all__ = ["Differences", "differences", "overlap"]

ORDERS = (2, 4, 6, 8)  # even ones have a frame in the middle
WINDOWS, WINDOW = 16, 64  # of longer sequences; more frames would tell hardly anything new


class Differences(NamedTuple):
    """Differences of one order: squared norms, vectors in the body frame, and which count.

    Scaled so that the noise of single frames keeps its size, where it is small. Time comes last:
    most of what follows sums along it.
    """

    order: int
    square: Tensor  # (..., J, windows, N)
    vector: Tensor  # (3, ..., J, windows, N)
    valid: Tensor  # (..., J, windows, N)


def differences(q: Tensor, present: Tensor) -> Iterator[Differences]:
    """Differences of every order that the length allows, at least one.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm and sign.
        present: Booleans ``(..., T, J)``.
    """
    frame, valid, linked = _windows(present.mT)
    work = q.float() if q.dtype.itemsize < 4 else q
    rows = [plane.mT.gather(-1, frame.flatten(-2)) for plane in work.unbind(-1)]
    unit = so3.normalize(_planes.join(rows)).movedim(-1, 0).unflatten(-1, frame.shape[-2:])
    return _of_rows(unit, valid, linked)


def overlap(order: int) -> float:
    """How many squared differences of white noise are worth one that is independent."""
    gain = math.comb(2 * order, order)
    lags = (math.comb(2 * order, order + lag) / gain for lag in range(1, order + 1))
    return 1.0 + 2.0 * sum(correlation**2 for correlation in lags)


def _windows(present: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Frames to look at ``(..., J, N, S)``, whether each is one, and if it follows that before.

    All frames present, one after the other; where hardly any lie side by side, taken as if they
    did.
    """
    frames = present.shape[-1]
    count = present.sum(-1, keepdim=True)
    pairs = (present[..., 1:] & present[..., :-1]).sum(-1, keepdim=True)
    longer = torch.sym_min(torch.sym_max(frames - 1, 0) // (WINDOWS * WINDOW), 1)  # or 0
    number = 1 + longer * (WINDOWS - 1)
    size = frames + longer * (WINDOW - frames)
    index = torch.arange(number, device=present.device)
    between = (count - number * size).clamp(min=0)
    last = torch.sym_max(number - 1, 1)
    ahead, back = (each * between // last for each in (index, number - 1 - index))
    start = index * size + torch.where(2 * index < number, ahead, between - back)
    rank = start[..., None] + torch.arange(size, device=present.device)
    source = _packed(present).gather(-1, rank.flatten(-2).clamp(max=frames - 1))
    source = source.unflatten(-1, rank.shape[-2:])
    follows = (source[..., 1:] - source[..., :-1] == 1) | (2 * pairs < count)[..., None]
    return source, rank < count[..., None], follows


def _packed(present: Tensor) -> Tensor:
    """Frames in their order, those present first."""
    frame = torch.arange(present.shape[-1], device=present.device).expand(present.shape)
    if visible(present) and bool(present.all()):
        return frame
    here = present.cumsum(-1)
    place = torch.where(present, here - 1, here[..., -1:] + frame - here)
    return torch.zeros_like(place).scatter(-1, place, frame)


def _of_rows(planes: Tensor, present: Tensor, follows: Tensor) -> Iterator[Differences]:
    """By the matrices ``q q^T``, which do not know signs: rotations lie twice as far apart.

    A sequence too short for the lowest order gets one difference that does not count.
    """
    short = max(ORDERS[0] + 1 - planes.shape[-1], 0)
    planes, present = (torch.nn.functional.pad(x, (0, short)) for x in (planes, present))
    follows = torch.nn.functional.pad(follows, (0, present.shape[-1] - 1 - follows.shape[-1]))
    row, column = torch.triu_indices(4, 4, device=planes.device)
    steps = planes[row] * planes[column]  # the upper triangle
    twice = torch.where(row == column, 1.0, 2.0).to(steps).reshape(-1, *(1,) * present.dim())
    valid = present[..., 1:] & present[..., :-1] & follows
    for order in range(1, min(ORDERS[-1], planes.shape[-1] - 1) + 1):
        steps = steps[..., 1:] - steps[..., :-1]
        if order > 1:
            valid = valid[..., 1:] & valid[..., :-1]
        if order in ORDERS:
            gain = math.comb(2 * order, order)
            square = (2.0 / gain) * (twice * steps.square()).sum(0)
            vector = _body_vector(planes.narrow(-1, order // 2, steps.shape[-1]), steps)
            yield Differences(order, square, (2.0 / gain**0.5) * vector, valid)


def _body_vector(q: Tensor, steps: Tensor) -> Tensor:
    """Vector part of ``q^-1 (S q)`` for symmetric matrices, given by their upper triangles."""
    rows = ((0, 1, 2, 3), (1, 4, 5, 6), (2, 5, 7, 8), (3, 6, 8, 9))
    x, y, z, w = (_planes.dot([steps[k] for k in row], q.unbind(0)) for row in rows)
    return torch.stack(_planes.vector_part(q.unbind(0), (x, y, z, w)))
