"""Rotations as vectors about a smooth motion near them, in which white noise stays white.

About one fixed rotation a logarithm stretches what lies far away. Here each frame's logarithm is
taken at a smooth motion, and the body-frame increments of that motion are summed up beside it.
"""

from functools import reduce

import torch
from torch import Tensor

from torchquat import _planes, so3
from torchquat._blocks import Window, in_windows
from torchquat._planes import Quaternion

__all__ = ["ROUGH_RADIUS", "path_of", "rough_motion"]

ROUGH_RADIUS = 4  # of a first guess at a motion [frames]
SQUARINGS = 4  # of a symmetric matrix, until its largest eigenvalue is all that is left


def path_of(motion: Tensor) -> Tensor:
    """A motion as a path of vectors: the running sum of its increments in the body frame.

    Args:
        motion: Unit quaternions ``(..., T, J, 4)``.

    Returns:
        Vectors ``(..., T, J, 3)`` [rad], 0 in the first frame.
    """
    frame = torch.arange(motion.shape[-3], device=motion.device)
    before = motion.index_select(-3, (frame - 1).clamp(min=0))
    return so3.between(before, motion).cumsum(-3)


def rough_motion(q: Tensor, radius: int) -> Tensor:
    """Mean rotations of running windows: the main axes of the mean of ``q q^T``.

    Signs do not matter to it, and noise of half a radian does not upset it.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        radius: Half-width of the window [frames].

    Returns:
        Unit quaternions ``(..., T, J, 4)``.
    """
    edge = q.new_zeros((*q.shape[:-3], radius, *q.shape[-2:]))
    padded = torch.cat([x.movedim(-1, 0) for x in (edge, q, edge)], -2)  # zeros add nothing

    def make(window: Window) -> Quaternion:
        here = _planes.cut(_planes.components(window.q), radius, window.frames)
        matrix = [_running_sum(x, radius) for x in _squares(window.q)]
        return _towards_main_axis(matrix, here)

    return so3.normalize(in_windows(make, padded.movedim(0, -1), None, radius))


def _squares(q: Tensor) -> list[Tensor]:
    """The upper triangles of ``q q^T``, row by row."""
    parts = q.unbind(0)
    return [parts[i] * parts[j] for i in range(4) for j in range(i, 4)]


def _running_sum(x: Tensor, radius: int) -> Tensor:
    """Sums over ``2 radius + 1`` frames of ``(..., N, J)``, which are as many fewer."""
    frames = x.shape[-2] - 2 * radius
    return reduce(torch.add, [x.narrow(-2, start, frames) for start in range(2 * radius + 1)])


def _towards_main_axis(matrix: list[Tensor], q: Quaternion) -> Quaternion:
    """``M^16 q`` of symmetric matrices, given by their upper triangles, up to a factor."""
    scale = (matrix[0] + matrix[4] + matrix[7] + matrix[9]).reciprocal()  # to a trace of 1
    matrix = [scale * entry for entry in matrix]
    for _ in range(SQUARINGS):
        rows = _rows(matrix)
        matrix = [_planes.dot(rows[i], rows[j]) for i in range(4) for j in range(i, 4)]
    x, y, z, w = (_planes.dot(row, q) for row in _rows(matrix))
    return x, y, z, w


def _rows(matrix: list[Tensor]) -> list[list[Tensor]]:
    places = ((0, 1, 2, 3), (1, 4, 5, 6), (2, 5, 7, 8), (3, 6, 8, 9))
    return [[matrix[place] for place in row] for row in places]
