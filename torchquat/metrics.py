"""What a filter gained and what it lost.

Quaternions here are complete: fill missing frames first (:func:`torchquat.fill_missing`). Means run
over everything given. A sequence too short for a difference counts as standing still.
"""

import math

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_layout

__all__ = [
    "angular_acceleration",
    "angular_velocity",
    "geodesic_rmse_deg",
    "jitter",
    "mean_squared_error",
    "peak_speed_kept",
    "psnr",
]


def mean_squared_error(q: Tensor, reference: Tensor) -> Tensor:
    """Mean squared rotation angle between two sequences.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        reference: Unit quaternions of the same shape.

    Returns:
        One value [rad^2].

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ or are not ``(..., T, J, 4)``.

    Reference:
        Courty, EUSIPCO 2008, section 5, with the rotation angle instead of its half.
    """
    _check_pair(q, reference)
    square = so3.squared_distance(so3.normalize(q), so3.normalize(reference))
    return square.sum() / max(square.numel(), 1)


def geodesic_rmse_deg(q: Tensor, reference: Tensor) -> Tensor:
    """Root of :func:`mean_squared_error`, in degrees."""
    return torch.rad2deg(mean_squared_error(q, reference).sqrt())


def psnr(q: Tensor, reference: Tensor) -> Tensor:
    """Peak signal-to-noise ratio: ``10 log10(pi^2 / mean squared rotation angle)`` [dB].

    Arguments as in :func:`mean_squared_error`. Infinite for equal sequences.

    Reference:
        Dean, "Non-Local Pose Means", Table I.
    """
    return 10.0 * torch.log10(math.pi**2 / mean_squared_error(q, reference))


def angular_velocity(q: Tensor, *, frame_rate: float = 1.0) -> Tensor:
    """Body-frame angular velocity between neighbouring frames.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        frame_rate: Frames per second; 1 gives radians per frame.

    Returns:
        Vectors ``(..., max(T - 1, 0), J, 3)`` [rad/s].

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape.
    """
    check_layout(q)
    q = so3.normalize(q)
    return so3.between(q[..., :-1, :, :], q[..., 1:, :, :]) * frame_rate


def angular_acceleration(q: Tensor, *, frame_rate: float = 1.0) -> Tensor:
    """Difference of neighbouring angular velocities.

    Arguments as in :func:`angular_velocity`.

    Returns:
        Vectors ``(..., max(T - 2, 0), J, 3)`` [rad/s^2].
    """
    return angular_velocity(q, frame_rate=frame_rate).diff(dim=-3) * frame_rate


def jitter(q: Tensor, *, frame_rate: float = 1.0) -> Tensor:
    """Mean norm of the angular jerk, the third difference of the rotations.

    Arguments as in :func:`angular_velocity`.

    Returns:
        One value [rad/s^3].
    """
    jerk = angular_acceleration(q, frame_rate=frame_rate).diff(dim=-3) * frame_rate
    return jerk.norm(dim=-1).sum() / max(jerk[..., 0].numel(), 1)


def peak_speed_kept(q: Tensor, reference: Tensor, *, quantile: float = 1.0) -> Tensor:
    """Peak angular speed of ``q`` as a share of that of ``reference``.

    The peaks of all joints are added up before dividing, so joints at rest do not count.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        reference: Unit quaternions of the same shape: the clean motion, or the one before.
        quantile: Which speed over time is the peak, in [0, 1]; below 1 it ignores single pops.

    Returns:
        One value; 1 where the reference stands still.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ or are not ``(..., T, J, 4)``.
    """
    _check_pair(q, reference)
    if q.shape[-3] < 2 or q.numel() == 0:
        return q.new_ones(())
    kept, all_of_it = (
        torch.quantile(angular_velocity(each).norm(dim=-1), quantile, dim=-2).sum()
        for each in (q, reference)
    )
    return torch.where(all_of_it > 0, kept / torch.where(all_of_it > 0, all_of_it, 1.0), 1.0)


def _check_pair(q: Tensor, reference: Tensor) -> None:
    check_layout(q)
    check_layout(reference, "reference")
    if q.shape != reference.shape:
        raise ValueError(
            f"reference must have the shape of q, {tuple(q.shape)}, got {tuple(reference.shape)}."
        )
