"""Means and quantiles over time of what counts."""

import torch
from torch import Tensor

__all__ = ["WINDOW", "masked_mean", "quantile", "running_mean"]

WINDOW = 9  # [frames] of the running mean


def masked_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean over time of what is valid, ``(..., 1, J)``; 0 of nothing."""
    total = torch.where(valid, x, 0.0).sum(-2, keepdim=True)
    return total / valid.sum(-2, keepdim=True).clamp(min=1)


def quantile(x: Tensor, valid: Tensor, share: float) -> Tensor:
    """The value of this rank among those valid, ``(..., 1, J)``; 0 of nothing."""
    ordered = torch.where(valid, x, torch.inf).sort(-2).values
    count = valid.sum(-2, keepdim=True)
    rank = (share * (count - 1).clamp(min=0)).long()
    return torch.where(count > 0, ordered.gather(-2, rank), 0.0)


def running_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean of what is valid within 4 frames to each side, ``(..., T, J)``."""
    both = torch.stack([torch.where(valid, x, 0.0), valid.to(x.dtype)])
    half = WINDOW // 2
    edge = both.new_zeros((*both.shape[:-2], half, both.shape[-1]))
    padded = torch.cat([edge, both, edge], -2)
    frames = x.shape[-2]
    # summed one by one: a running sum would leave the rounding errors of loud times in quiet ones
    total, count = sum(padded.narrow(-2, lag, frames) for lag in range(WINDOW))
    return total / count.clamp(min=1.0)
