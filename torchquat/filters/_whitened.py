"""Motions in units of their noise, and along the axes that they move about."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import so3

__all__ = ["Units", "along", "away_from", "main_axes", "rows", "units_of"]


class Units(NamedTuple):
    """What a joint's noise makes of it.

    Attributes:
        noisy: Whether there is noise in a joint that is ever seen, ``(..., 1, J, 1)``.
        scale: Size of the noise [rad], 1 where there is none, ``(..., 1, J, 1)``.
        trust: Confidence over the largest of the joint ``(..., T, J, 1)``; ``None``: all alike.
    """

    noisy: Tensor
    scale: Tensor
    trust: Tensor | None


def units_of(sigma: Tensor, weight: Tensor | None) -> Units:
    """From noise ``(..., J)`` and confidences ``(..., T, J)``."""
    noisy = (sigma > 0)[..., None, :, None]
    scale = torch.where(sigma > 0, sigma, 1.0)[..., None, :, None]
    if weight is None:
        return Units(noisy, scale, None)
    largest = weight.amax(-2, keepdim=True)
    trust = (weight / torch.where(largest > 0, largest, 1.0))[..., None].detach()
    return Units(noisy & (largest > 0)[..., None], scale, trust)


def away_from(motion: Tensor, q: Tensor, units: Units) -> Tensor:
    """From a motion to the data, in units of the noise; what is not believed lies on the motion."""
    away = so3.between(motion, q)
    return (away if units.trust is None else units.trust * away) / units.scale


def along(v: Tensor, axes: Tensor) -> Tensor:
    """Components of vectors ``(..., T, J, 3)`` along the columns of ``(..., J, 3, 3)``."""
    return (v[..., None] * axes[..., None, :, :, :]).sum(-2)


def main_axes(path: Tensor) -> Tensor:
    """Principal axes ``(..., J, 3, 3)`` of the steps of a path, one a column."""
    frame = torch.arange(path.shape[-3], device=path.device)
    step = path - path.index_select(-3, (frame - 1).clamp(min=0))
    return torch.linalg.eigh((step[..., None] * step[..., None, :]).sum(-4))[1]


def rows(v: Tensor) -> Tensor:
    """Vectors ``(..., T, J, 3)`` as channels ``(N, T, 3 J)``."""
    return v.reshape(-1, v.shape[-3], v.shape[-2] * v.shape[-1])
