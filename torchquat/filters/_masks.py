"""Fixed masks along time, on the increments of rotations."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat._eager import derivatives, lowest, numbers, visible
from torchquat._planes import Vector
from torchquat.filters._lee_shin import move, tangent_mean
from torchquat.timeline import Boundary

__all__ = ["as_mask", "check_mask", "convolve", "masked_mean"]


def convolve(
    unit: Tensor, confidence: Tensor | None, mask: Tensor, *, boundary: Boundary, causal: bool
) -> Tensor:
    """Filter with a mask ``(2k + 1, J or 1)`` that may have negative entries."""
    rising = mask.clamp(min=0)
    falling = mask - rising  # not clamped: derivatives by an entry that is 0 would count twice

    def step(window: Tensor, trust: Tensor | None, rising: Tensor, falling: Tensor) -> Vector:
        up, up_total = masked_mean(window, trust, rising, causal=causal)
        if lowest(falling) >= 0:
            return up
        down, down_total = masked_mean(window, trust, -falling, causal=causal)
        gain, loss, least = rising.sum(0), falling.sum(0), torch.finfo(rising.dtype).tiny
        # where one sign has no frame left, the other stands for both
        x, y, z = (
            gain * torch.where(up_total >= least, u, d)
            + loss * torch.where(down_total >= least, d, u)
            for u, d in zip(up, down, strict=True)
        )
        return x, y, z

    shared = (rising, falling)
    return move(unit, confidence, step, radius=len(mask) // 2, boundary=boundary, shared=shared)


def masked_mean(
    window: Tensor, trust: Tensor | None, mask: Tensor, *, causal: bool
) -> tuple[Vector, Tensor]:
    """Tangent mean for a mask ``(2k + 1, J or 1)`` >= 0."""
    radius = len(mask) // 2
    rows = numbers(mask)
    fixed = visible(mask) and not derivatives(mask)
    symmetric = fixed and torch.equal(mask, mask.flip(0))
    return tangent_mean(
        window,
        trust,
        lambda lag, squared_angle: (rows[radius + lag], rows[radius - lag]),
        centre=rows[radius],
        radius=radius,
        causal=causal,
        fixed=fixed,
        rate=0.0 if symmetric else None,
    )


def as_mask(mask: Tensor | Sequence[float], like: Tensor) -> Tensor:
    """Mask ``(2k + 1, J or 1)`` in the dtype of ``like``."""
    mask = torch.as_tensor(mask, dtype=like.dtype, device=like.device)
    if mask.dim() not in (1, 2) or len(mask) % 2 == 0:
        raise ValueError(f"mask must have shape (2k + 1,) or (2k + 1, J), got {tuple(mask.shape)}.")
    if like.dim() > 2 and mask.dim() == 2 and mask.shape[1] not in (1, like.shape[-2]):
        joints = like.shape[-2]
        raise ValueError(f"mask must have one column or {joints}, got {mask.shape[1]}.")
    # what is too small to divide by would make a mean of nothing; 0 itself may be learned from
    subnormal = (mask != 0) & (mask.abs() < torch.finfo(mask.dtype).tiny)
    mask = torch.where(subnormal, 0.0, mask)
    return mask.reshape(len(mask), -1)


def check_mask(mask: Tensor) -> None:
    """Raise unless the mask is finite and can be divided by its sum, where that can be seen."""
    if visible(mask) and not bool(mask.isfinite().all() and (mask.sum(0) > 0).all()):
        raise ValueError(f"mask must be finite with a sum > 0, got {mask.squeeze(-1).tolist()}.")
