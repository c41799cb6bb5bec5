"""Motions in units of their noise, and along the axes that they move about."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import so3
from torchquat._eager import highest
from torchquat.noise._principal import Principal

__all__ = [
    "Stretch",
    "Units",
    "along",
    "away_from",
    "in_radians",
    "in_units",
    "main_axes",
    "mean_size",
    "rows",
    "stretch_of",
    "units_of",
]

ROUGHEST = 0.03
"""Motion looks like noise of that size about one axis [rad]: in 24 clips of people, filmed 30 times
a second, four joints in a hundred go beyond half of it, and one in a thousand beyond 0.042."""
SURE = 2.0  # standard errors by which noise about one axis must be larger


class Stretch(NamedTuple):
    """Noise that is larger about some axes.

    Attributes:
        axes: One a column, in the joint's own frame ``(..., J, 3, 3)``.
        factor: How much larger than the noise of the joint, at least 1, ``(..., J, 3)``.
    """

    axes: Tensor
    factor: Tensor


class Units(NamedTuple):
    """What a joint's noise makes of it.

    Attributes:
        noisy: Whether there is noise in a joint that is ever seen, ``(..., 1, J, 1)``.
        scale: Size of the noise [rad], 1 where there is none, ``(..., 1, J, 1)``.
        trust: Confidence over the largest of the joint ``(..., T, J, 1)``; ``None``: all alike.
        stretch: About which axes it is larger; ``None``: about none.
    """

    noisy: Tensor
    scale: Tensor
    trust: Tensor | None
    stretch: Stretch | None


def stretch_of(principal: Principal, sigma: Tensor) -> Stretch | None:
    """About which axes a joint trembles more than noise ``(..., J)`` and motion explain.

    Returns:
        ``None`` if no joint does, where values may be looked at.
    """
    shrink = (1.0 - SURE * principal.error).clamp(min=0.0).square()[..., None]
    power, least = principal.size.square(), sigma.square()[..., None]
    larger = (shrink * power - ROUGHEST**2 > least) & (least > 0)
    ratio = (power - ROUGHEST**2) / torch.where(larger, least, 1.0)
    factor = torch.where(larger, ratio, 1.0).sqrt()
    return None if highest(factor) == 1.0 else Stretch(principal.axes, factor)


def mean_size(sigma: Tensor, stretch: Stretch | None) -> Tensor:
    """Root mean square over the axes of noise ``(..., J)``."""
    return sigma if stretch is None else sigma * stretch.factor.square().mean(-1).sqrt()


def units_of(sigma: Tensor, weight: Tensor | None, stretch: Stretch | None = None) -> Units:
    """From noise ``(..., J)``, confidences ``(..., T, J)``, and where noise is larger."""
    noisy = (sigma > 0)[..., None, :, None]
    scale = torch.where(sigma > 0, sigma, 1.0)[..., None, :, None]
    if weight is None:
        return Units(noisy, scale, None, stretch)
    largest = weight.amax(-2, keepdim=True)
    trust = (weight / torch.where(largest > 0, largest, 1.0))[..., None].detach()
    return Units(noisy & (largest > 0)[..., None], scale, trust, stretch)


def away_from(motion: Tensor, q: Tensor, units: Units) -> Tensor:
    """From a motion to the data, in units of the noise; what is not believed lies on the motion."""
    away = so3.between(motion, q)
    return in_units(away if units.trust is None else units.trust * away, units)


def in_units(v: Tensor, units: Units) -> Tensor:
    """Vectors ``(..., T, J, 3)`` [rad] in units of the noise about each axis."""
    return _stretched(v / units.scale, units.stretch, -1)


def in_radians(v: Tensor, units: Units) -> Tensor:
    """The inverse of :func:`in_units`."""
    return units.scale * _stretched(v, units.stretch, 1)


def _stretched(v: Tensor, stretch: Stretch | None, power: int) -> Tensor:
    """Exactly as they are where the factors are 1."""
    if stretch is None:
        return v
    more = (stretch.factor**power - 1.0)[..., None, :, :]
    return v + along(more * along(v, stretch.axes), stretch.axes.mT)


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
