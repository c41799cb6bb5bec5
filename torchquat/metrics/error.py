"""How far a sequence is from another."""

import math

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_layout

__all__ = ["check_pair", "geodesic_rmse_deg", "mean_squared_error", "psnr", "single"]


def mean_squared_error(q: Tensor, reference: Tensor) -> Tensor:
    """Mean squared rotation angle between two sequences.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        reference: Unit quaternions of the same shape.

    Returns:
        One value [rad^2]; of half precision, in single.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ or are not ``(..., T, J, 4)``.

    Reference:
        Courty, EUSIPCO 2008, section 5, with the rotation angle instead of its half.
    """
    q, reference = check_pair(q, reference)
    square = so3.squared_distance(so3.normalize(q), so3.normalize(reference))
    return square.sum() / max(square.numel(), 1)


def geodesic_rmse_deg(q: Tensor, reference: Tensor) -> Tensor:
    """Root of :func:`mean_squared_error`, in degrees; of derivative 0 where that is 0."""
    square = mean_squared_error(q, reference)
    root = torch.where(square > 0, torch.where(square > 0, square, 1.0).sqrt(), square)
    return torch.rad2deg(root)


def psnr(q: Tensor, reference: Tensor) -> Tensor:
    """Peak signal-to-noise ratio: ``10 log10(pi^2 / mean squared rotation angle)`` [dB].

    Arguments as in :func:`mean_squared_error`. Infinite for equal sequences.

    Reference:
        Dean, "Non-Local Pose Means", Table I.
    """
    return 10.0 * torch.log10(math.pi**2 / mean_squared_error(q, reference))


def single(q: Tensor) -> Tensor:
    """Quaternions in single precision at least: sums and speeds do not fit half."""
    return q.float() if q.dtype.itemsize < 4 else q


def check_pair(q: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
    """Both in single precision at least.

    Raises:
        TypeError: If one is not a floating-point tensor.
        ValueError: Unless both are quaternions ``(..., T, J, 4)`` of one shape.
    """
    check_layout(q)
    check_layout(reference, "reference")
    if q.shape != reference.shape:
        raise ValueError(
            f"reference must have the shape of q, {tuple(q.shape)}, got {tuple(reference.shape)}."
        )
    return single(q), single(reference)
