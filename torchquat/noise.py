"""Corruption of clean rotations, for tests and benchmarks. Every draw takes a ``generator``."""

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
    check_layout(q)
    work = q.float() if q.dtype.itemsize < 4 else q
    scale = torch.as_tensor(sigma, dtype=work.dtype, device=work.device)
    if not bool((scale.isfinite() & (scale >= 0)).all()):
        raise ValueError(f"sigma must be finite and >= 0, got {sigma}.")
    draw = torch.randn(
        (*q.shape[:-1], 3), generator=generator, dtype=work.dtype, device=work.device
    )
    turn = scale[..., None] * draw
    return so3.turn(so3.normalize(work), turn).to(q.dtype)


def impulse(
    q: Tensor,
    sigma: float | Sequence[float] | Tensor,
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
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"share must be in [0, 1], got {share}.")
    turned = gaussian(q, sigma, generator=generator)
    chance = torch.rand(q.shape[:-1], generator=generator, device=q.device)
    return torch.where((chance < share)[..., None], turned, so3.normalize(q))
