"""Means and ranks over time, the last axis, of what counts."""

import torch
from torch import Tensor

__all__ = ["masked_mean", "quantile", "running_mean"]

MOST = 512  # values that are sorted
HALF_WINDOW = 4  # [frames] on each side of the running mean


def masked_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean of what is valid, ``(..., 1)``; 0 of nothing. All must be finite."""
    counted = valid.to(x.dtype)
    return (counted * x).sum(-1, keepdim=True) / counted.sum(-1, keepdim=True).clamp(min=1.0)


def quantile(x: Tensor, valid: Tensor, share: float) -> Tensor:
    """The value of this rank among those valid of at most 512, evenly spread, ``(..., 1)``.

    0 of nothing.
    """
    place = _evenly_spread(x.shape[-1], x.device)
    x, valid = (each.index_select(-1, place) for each in (x, valid))
    ordered = torch.where(valid, x, torch.inf).sort(-1).values
    count = valid.sum(-1, keepdim=True)
    rank = (share * (count - 1).clamp(min=0)).long()
    return torch.where(count > 0, ordered.gather(-1, rank), 0.0)


def _evenly_spread(length: int, device: torch.device) -> Tensor:
    """All places, or 512 of them, symmetric about the middle."""
    count = torch.sym_min(length, MOST)
    index = torch.arange(count, device=device)
    ahead = index * (length - 1) // torch.sym_max(count - 1, 1)
    return torch.where(2 * index < count, ahead, length - 1 - ahead.flip(0))


def running_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean of what is valid within 4 frames to each side, ``(..., T)``. All must be finite."""
    counted = valid.to(x.dtype)
    both = torch.stack([counted * x, counted])
    padded = torch.nn.functional.pad(both, (HALF_WINDOW + 1, HALF_WINDOW)).cumsum(-1)
    total, count = padded[..., 2 * HALF_WINDOW + 1 :] - padded[..., : x.shape[-1]]
    return total.clamp(min=0.0) / count.clamp(min=1.0)
