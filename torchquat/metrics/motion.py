"""How fast and how far rotations move, and how much of that a filter kept."""

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_count, check_layout
from torchquat.metrics.error import check_pair, single

__all__ = [
    "angular_acceleration",
    "angular_velocity",
    "jitter",
    "lag",
    "peak_speed_kept",
    "range_of_motion_kept",
]


def angular_velocity(q: Tensor, *, frame_rate: float = 1.0) -> Tensor:
    """Body-frame angular velocity between neighbouring frames.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        frame_rate: Frames per second; 1 gives radians per frame.

    Returns:
        Vectors ``(..., max(T - 1, 0), J, 3)`` [rad/s]; of half precision, in single.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape.
    """
    check_layout(q)
    q = so3.normalize(single(q))
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
    q, reference = check_pair(q, reference)
    if q.shape[-3] < 2 or q.numel() == 0:
        return q.new_ones(())
    kept, all_of_it = (
        _peak_speed(angular_velocity(each).norm(dim=-1), quantile).sum() for each in (q, reference)
    )
    return _share(kept, all_of_it)


def range_of_motion_kept(q: Tensor, reference: Tensor) -> Tensor:
    """Range of motion of ``q`` as a share of that of ``reference``.

    The range of a joint is the angle between its two extremes: the rotation farthest from the first
    frame, and the one farthest from that. The ranges of all joints are added up before dividing.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        reference: Unit quaternions of the same shape: the clean motion, or the one before.

    Returns:
        One value; 1 where the reference stands still.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ or are not ``(..., T, J, 4)``.
    """
    q, reference = check_pair(q, reference)
    if q.numel() == 0:
        return q.new_ones(())
    kept, all_of_it = (_range(so3.normalize(each)).sum() for each in (q, reference))
    return _share(kept, all_of_it)


def lag(q: Tensor, reference: Tensor, *, max_lag: int = 10) -> Tensor:
    r"""By how many frames ``q`` is late.

    .. math::
        \arg\max_d \frac{\sum_{t, j} s_j(t)\, r_j(t - d)}
        {\sqrt{\sum_{t, j} s_j(t)^2 \sum_{t, j} r_j(t - d)^2}}

    with the angular speeds :math:`s` of ``q`` and :math:`r` of the reference, each joint's mean
    over the window taken off. The window leaves out ``max_lag`` frames at either end, so that it is
    as long for every d. The peak lies on the parabola through the best d and its neighbours. Speeds
    do not tell a motion from its mirror image, nor one swing from the next.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        reference: Unit quaternions of the same shape: the clean motion, or the one before.
        max_lag: The largest delay or advance that is looked for [frames], >= 1; a quarter of the
            sequence at most.

    Returns:
        One value [frames], > 0 where ``q`` comes later; 0 where speeds do not change.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ or are not ``(..., T, J, 4)``, or ``max_lag`` < 1.
    """
    q, reference = check_pair(q, reference)
    check_count("max_lag", max_lag, 1)
    steps = q.shape[-3] - 1
    reach = min(max_lag, steps // 4)
    if reach < 1 or q.numel() == 0:
        return q.new_zeros(())
    speed, known = (angular_velocity(each).norm(dim=-1) for each in (q, reference))
    inner = steps - 2 * reach
    own = _centred(speed.narrow(-2, reach, inner))
    delays = range(-reach, reach + 1)
    likeness = torch.stack(
        [_correlation(own, _centred(known.narrow(-2, reach - d, inner))) for d in delays]
    )
    changes = torch.minimum(own.square().sum(), _centred(known).square().sum())
    rounding = torch.finfo(q.dtype).eps * speed.square().sum()
    return torch.where(changes > rounding, _peak(likeness) - reach, 0.0)


def _peak_speed(speed: Tensor, quantile: float) -> Tensor:
    """Quantile over time; the highest needs no sorting."""
    return speed.amax(-2) if quantile == 1.0 else torch.quantile(speed, quantile, dim=-2)


def _range(q: Tensor) -> Tensor:
    """Angle ``(..., J)`` between the extremes of unit quaternions ``(..., T, J, 4)``."""
    farthest = so3.squared_distance(q, q[..., :1, :, :]).argmax(-2, keepdim=True)
    extreme = q.gather(-3, farthest[..., None].expand(*farthest.shape, 4))
    return so3.distance(q, extreme).amax(-2)


def _share(kept: Tensor, all_of_it: Tensor) -> Tensor:
    """The quotient; 1 where there is nothing to keep."""
    return torch.where(all_of_it > 0, kept / torch.where(all_of_it > 0, all_of_it, 1.0), 1.0)


def _centred(speed: Tensor) -> Tensor:
    return speed - speed.mean(-2, keepdim=True)


def _correlation(a: Tensor, b: Tensor) -> Tensor:
    """Correlation over everything; 0 where one of them is 0."""
    power = a.square().sum() * b.square().sum()
    root = torch.where(power > 0, power, 1.0).sqrt()
    return (a * b).sum() / root


def _peak(values: Tensor) -> Tensor:
    """Where a curve ``(N,)`` is highest, between the samples if it falls off on both sides."""
    best = values.argmax()
    inside = best.clamp(1, len(values) - 2)
    before, here, after = (values[inside + step] for step in (-1, 0, 1))
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / torch.where(bend < 0, bend, -1.0)
    return torch.where(best == inside, inside + shift.clamp(-0.5, 0.5), best.to(values.dtype))
