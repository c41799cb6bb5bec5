"""Corruption of clean rotations, for tests and benchmarks. Every draw takes a ``generator``."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_layout

__all__ = ["gaussian", "impulse"]


def gaussian(
    q: Tensor,
    sigma: float | Sequence[float] | Tensor,
    *,
    generator: torch.Generator | None = None,
) -> Tensor:
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
    work = _checked(q)
    scale = torch.as_tensor(sigma, dtype=work.dtype, device=work.device)
    if not bool((scale.isfinite() & (scale >= 0)).all()):
        raise ValueError(f"sigma must be finite and >= 0, got {sigma}.")
    turn = scale[..., None] * _draw(work, generator)
    return so3.compose(so3.normalize(work), so3.exp(turn)).to(q.dtype)


def impulse(
    q: Tensor,
    angle: float,
    *,
    share: float = 0.05,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Turn single joint samples by one angle about axes of any direction; leave the others.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        angle: How far [rad], >= 0.
        share: Probability of each joint sample to be turned, in [0, 1].
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape, or a value is out of its range.

    Reference:
        Dean, "Non-Local Pose Means", Table I, which names neither angle nor share.
    """
    work = _checked(q)
    if not 0.0 <= angle < math.inf:
        raise ValueError(f"angle must be finite and >= 0, got {angle}.")
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"share must be in [0, 1], got {share}.")
    axis = _draw(work, generator)
    axis = axis / axis.norm(dim=-1, keepdim=True)
    chance = torch.rand(q.shape[:-1], generator=generator, dtype=work.dtype, device=work.device)
    turn = torch.where((chance < share)[..., None], angle * axis, 0.0)
    return so3.compose(so3.normalize(work), so3.exp(turn)).to(q.dtype)


def _checked(q: Tensor) -> Tensor:
    """``q`` in the precision to compute in."""
    check_layout(q)
    return q.float() if q.dtype.itemsize < 4 else q


def _draw(q: Tensor, generator: torch.Generator | None) -> Tensor:
    """Standard normal vectors ``(..., T, J, 3)``."""
    return torch.randn((*q.shape[:-1], 3), generator=generator, dtype=q.dtype, device=q.device)
