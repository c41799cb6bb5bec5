"""What all corruptions share: sizes, draws, and turns that leave missing frames alone."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_layout

__all__ = ["Sigma", "apply", "chances", "check_share", "turns", "unit_of"]

Sigma = float | Sequence[float] | Tensor


def unit_of(q: Tensor) -> Tensor:
    """Unit quaternions in float32 or float64; the identity where a row has no direction.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape than ``(..., T, J, 4)``.
    """
    check_layout(q)
    return so3.normalize(q.float() if q.dtype.itemsize < 4 else q)


def turns(
    q: Tensor, sigma: Sigma, generator: torch.Generator | None, *, frames: int | None = None
) -> Tensor:
    """Independent Gaussian rotation vectors ``(..., frames, J, 3)`` [rad], a frame of ``q`` each.

    Raises:
        ValueError: If a ``sigma`` is negative or not finite, or neither one nor one per joint.
    """
    scale = torch.as_tensor(sigma, dtype=q.dtype, device=q.device)
    if scale.dim() and scale.shape[-1] not in (1, q.shape[-2]):
        raise ValueError(
            f"sigma must be one value or one for each of {q.shape[-2]} joints, "
            f"got {tuple(scale.shape)}."
        )
    if not bool((scale.isfinite() & (scale >= 0)).all()):
        raise ValueError(f"sigma must be finite and >= 0, got {sigma}.")
    frames = q.shape[-3] if frames is None else frames
    shape = (*q.shape[:-3], frames, q.shape[-2], 3)
    draw = torch.randn(shape, generator=generator, dtype=q.dtype, device=q.device)
    return scale[..., None] * draw


def chances(q: Tensor, generator: torch.Generator | None, *, frames: int | None = None) -> Tensor:
    """Numbers spread evenly over [0, 1), ``(..., frames, J)``, float32."""
    frames = q.shape[-3] if frames is None else frames
    shape = (*q.shape[:-3], frames, q.shape[-2])
    return torch.rand(shape, generator=generator, device=q.device, dtype=torch.float32)


def apply(unit: Tensor, turn: Tensor, q: Tensor) -> Tensor:
    """``unit exp(turn)`` in the dtype of ``q``, and ``q`` itself where it has no direction."""
    return torch.where(so3.usable(q)[..., None], so3.turn(unit, turn).to(q.dtype), q)


def check_share(share: float) -> None:
    """Raise unless ``share`` is a probability."""
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"share must be in [0, 1], got {share}.")
