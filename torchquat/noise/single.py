"""Errors of single frames: each is drawn as if there were no other."""

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_choice, check_layout, check_positive
from torchquat.noise._draws import Sigma, apply, chances, check_share, turns, unit_of

__all__ = ["flip_signs", "gaussian", "impulse", "quantise"]

AXES = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")


def gaussian(q: Tensor, sigma: Sigma, *, generator: torch.Generator | None = None) -> Tensor:
    r"""Turn every rotation by an independent Gaussian rotation vector: ``q exp(v)``.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        sigma: Standard deviation of each component of ``v`` [rad], >= 0; one value or one per
            joint. The root mean square angle is :math:`\sqrt 3` times as large.
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape, or a ``sigma`` is negative or not finite.

    Reference:
        Dean, "Non-Local Pose Means", Table I; Courty, EUSIPCO 2008, Fig. 2.
    """
    unit = unit_of(q)
    return apply(unit, turns(unit, sigma, generator), q)


def impulse(
    q: Tensor,
    sigma: Sigma,
    *,
    share: float = 0.05,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Turn single joint samples as :func:`gaussian` does; leave the others as they are.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        sigma: As in :func:`gaussian`; 0.5 rad and more are the wild samples of trackers.
        share: Probability of each joint sample to be turned, in [0, 1].
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape, or a value is out of its range.

    Reference:
        Dean, "Non-Local Pose Means", Table I, which names neither size nor share.
    """
    check_share(share)
    unit = unit_of(q)
    turn = turns(unit, sigma, generator)
    turned = (chances(unit, generator) < share).to(turn.dtype)
    return apply(unit, turned[..., None] * turn, q)


def quantise(q: Tensor, step: float, *, axes: str | None = None) -> Tensor:
    """Round the numbers that a rotation is stored as, as files with few digits do.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        step: Distance of two neighbouring values [rad], > 0.
        axes: Order of intrinsic Euler angles, such as ``"ZXY"`` of most BVH files. ``None``: the
            components of the rotation vector, as in SMPL files.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor, or ``step`` not a number.
        ValueError: If ``q`` has another shape, ``step`` is not finite and > 0, or ``axes`` is not
            an order of X, Y and Z.
    """
    check_positive("step", step)
    unit = unit_of(q)
    if axes is None:
        rounded = so3.exp(_rounded(so3.log(unit), step))
    else:
        check_choice("axes", axes, AXES)
        import roma  # when first needed: it loads PyTorch's compiler

        angles = torch.stack(list(roma.unitquat_to_euler(axes, unit, as_tuple=True)), -1)
        rounded = roma.euler_to_unitquat(axes, _rounded(angles, step))
    rounded = so3.align(rounded, unit).to(q.dtype)
    return torch.where(so3.usable(q)[..., None], rounded, q)


def flip_signs(
    q: Tensor,
    *,
    share: float = 0.5,
    hold: bool = False,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Change the signs of quaternions at random; the rotations stay what they are.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm.
        share: Probability in [0, 1] of each joint sample to be negated.
        hold: ``share`` is instead the probability of the sign to change from one frame to the
            next, so that whole stretches lie in the other hemisphere, as where a converter from
            matrices switches its branch.
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape, or ``share`` is out of its range.
    """
    check_layout(q)
    check_share(share)
    sign = 1.0 - 2.0 * (chances(q, generator) < share).to(q.dtype)
    return (sign.cumprod(-2) if hold else sign)[..., None] * q


def _rounded(x: Tensor, step: float) -> Tensor:
    return (x / step).round() * step
