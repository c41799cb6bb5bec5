"""Rotations as vectors about a smooth motion near them, in which white noise stays white.

About one fixed rotation a logarithm stretches what lies far away. Here each frame's logarithm is
taken at a smooth motion, and the body-frame increments of that motion are summed up beside it.
"""

import torch
from torch import Tensor

from torchquat import so3

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
    row, column = torch.triu_indices(4, 4, device=q.device)
    mean = _running_mean(q[..., row] * q[..., column], radius)
    places = torch.tensor([0, 1, 2, 3, 1, 4, 5, 6, 2, 5, 7, 8, 3, 6, 8, 9], device=q.device)
    matrix = mean.index_select(-1, places).unflatten(-1, (4, 4))
    for _ in range(SQUARINGS):
        matrix = matrix @ matrix
        matrix = matrix / matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    return so3.normalize((matrix @ q[..., None])[..., 0])


def _running_mean(x: Tensor, radius: int) -> Tensor:
    """Means over ``2 radius + 1`` frames of ``(..., T, J, C)``, over fewer at the ends."""
    frames = x.shape[-3]
    rows = x.movedim(-3, -1).reshape(-1, 1, frames)
    mean = torch.nn.functional.avg_pool1d(rows, 2 * radius + 1, 1, radius, count_include_pad=False)
    return mean.reshape(*x.shape[:-3], *x.shape[-2:], frames).movedim(-1, -3)
