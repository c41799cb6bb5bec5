"""Poses as points: the logarithms of all joints at their mean rotations, one after the other."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import so3

__all__ = ["Chart", "Fit", "mean_rotation", "refitted"]

REFINEMENTS = 5


class Chart(NamedTuple):
    """Poses of sequences.

    Attributes:
        points: ``(N, T, 3 J)`` [rad], in float64; 0 for joints that are missing throughout.
        trust: Weights of their coordinates, of the same shape.
        mean: Mean rotations ``(N, 1, J, 4)``, in float64.
    """

    points: Tensor
    trust: Tensor
    mean: Tensor


Fit = Callable[[Chart], Tensor]
"""From poses as points to other points ``(N, T, 3 J)``."""


def refitted(unit: Tensor, confidence: Tensor | None, fit: Fit) -> Tensor:
    """Replace poses, seen as points around the mean pose, by what ``fit`` makes of them.

    In double precision: directions of little variance come from differences of large numbers. One
    sequence after the other, where that can be: products of matrices are rounded differently in
    batches.

    Args:
        unit: Unit quaternions ``(..., T, J, 4)``.
        confidence: Weights ``(..., T, J)``; ``None``: 1.
        fit: See :data:`Fit`.

    Returns:
        Unit quaternions ``(..., T, J, 4)``; a joint that is missing throughout keeps its own.
    """
    if unit.numel() == 0:
        return unit
    q = unit.reshape(-1, *unit.shape[-3:])
    weight = unit.new_ones(q.shape[:-1])
    if confidence is not None:
        weight = confidence.reshape(weight.shape)
    if torch.compiler.is_compiling():
        return _refitted(q, weight, fit).reshape(unit.shape)
    pairs = zip(q.split(1), weight.split(1), strict=True)
    return torch.cat([_refitted(*pair, fit) for pair in pairs]).reshape(unit.shape)


def _refitted(unit: Tensor, weight: Tensor, fit: Fit) -> Tensor:
    known = (weight > 0).any(1, keepdim=True)[..., None]
    # one layout, so that sums run in one order
    q = unit.double().clone(memory_format=torch.contiguous_format)
    weight = weight.double().clone(memory_format=torch.contiguous_format)
    mean = mean_rotation(q, weight)
    points = torch.where(known, so3.between(mean, q), 0.0)
    trust = weight[..., None].expand_as(points)
    moved = fit(Chart(points.flatten(-2), trust.flatten(-2), mean)).unflatten(-1, (-1, 3))
    return torch.where(known, so3.turn(mean, moved).to(unit.dtype), unit)


def mean_rotation(q: Tensor, weight: Tensor) -> Tensor:
    """Mean rotation of every joint: the smallest sum of squared angles.

    Args:
        q: Unit quaternions ``(N, T, J, 4)``.
        weight: Their weights ``(N, T, J)``.

    Returns:
        Unit quaternions ``(N, 1, J, 4)``.
    """
    share = weight / torch.where(weight.sum(1, keepdim=True) > 0, weight.sum(1, keepdim=True), 1.0)
    # a start that does not depend on order and signs, found by no derivative: steps from it forget
    # it, and their derivatives do so too
    start = q.detach()
    scatter = [
        [(share.detach() * a * b).sum(1) for a in start.unbind(-1)] for b in start.unbind(-1)
    ]
    matrix = torch.stack([torch.stack(row, -1) for row in scatter], -2)
    mean = torch.linalg.eigh(matrix).eigenvectors[..., -1][:, None]
    for _ in range(REFINEMENTS):
        mean = so3.turn(mean, (share[..., None] * so3.between(mean, q)).sum(1, keepdim=True))
    return mean
