"""Means and ranks over time, the last axis, of what counts."""

import torch
from torch import Tensor

__all__ = ["masked_mean", "quantile", "ranked", "running_mean"]

HALF_WINDOW = 4  # [frames] on each side of the running mean


def masked_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean of what is valid, ``(..., 1)``; 0 of nothing."""
    total = torch.where(valid, x, 0.0).sum(-1, keepdim=True)
    return total / valid.sum(-1, keepdim=True).clamp(min=1)


def ranked(x: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Values in rising order, infinity for those not valid, and how many are, ``(..., 1)``."""
    return torch.where(valid, x, torch.inf).sort(-1).values, valid.sum(-1, keepdim=True)


def quantile(ordered: Tensor, count: Tensor, share: float) -> Tensor:
    """The value of this rank, ``(..., 1)``; 0 of nothing."""
    rank = (share * (count - 1).clamp(min=0)).long()
    return torch.where(count > 0, ordered.gather(-1, rank), 0.0)


def running_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean of what is valid within 4 frames to each side, ``(..., T)``."""
    both = torch.stack([torch.where(valid, x, 0.0), valid.to(x.dtype)])
    padded = torch.nn.functional.pad(both, (HALF_WINDOW + 1, HALF_WINDOW)).cumsum(-1)
    total, count = padded[..., 2 * HALF_WINDOW + 1 :] - padded[..., : x.shape[-1]]
    return total.clamp(min=0.0) / count.clamp(min=1.0)
