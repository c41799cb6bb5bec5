"""Noise that is larger about some axes of a joint than about others."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchquat.noise._axes import AXES, moment
from torchquat.noise._differences import Differences, overlap
from torchquat.noise._ranks import quantile

__all__ = ["Principal", "principal"]

BULK = 0.75  # of the vectors, shorter than the others, tell the axes
NORMAL = 0.67449  # median of the absolute value of a standard Gaussian number
EFFICIENCY = 1.17  # standard error of the median deviation, over that of the root mean square


class Principal(NamedTuple):
    """How much a joint trembles about each of its own axes.

    Attributes:
        axes: Orthonormal, one a column, in the joint's own frame ``(..., J, 3, 3)``.
        size: Standard deviation about each [rad], as for :func:`torchquat.noise.gaussian`,
            ``(..., J, 3)``; quick motion is in it, too.
        error: Relative standard error of the sizes ``(..., J)``.
    """

    axes: Tensor
    size: Tensor
    error: Tensor


def principal(found: list[Differences]) -> Principal:
    """Axes of the highest differences, and the least median deviation of all orders about them.

    Medians see neither outliers nor bursts of motion.
    """
    highest = found[-1]
    vector, valid = highest.vector.flatten(-2), highest.valid.flatten(-2)
    length = highest.square.flatten(-2)
    bulk = valid & (length <= quantile(length, valid, BULK))
    axes = torch.linalg.eigh(moment(vector, bulk))[1].to(vector.dtype)
    size = torch.stack([_deviations(each, axes) for each in found[-3:]]).amin(0)
    independent = valid.sum(-1).to(vector.dtype) / overlap(highest.order)
    return Principal(axes, size, EFFICIENCY * (2.0 * independent.clamp(min=1.0)).rsqrt())


def _deviations(found: Differences, axes: Tensor) -> Tensor:
    """Median absolute component about every axis, as a standard deviation ``(..., J, 3)``."""
    vector, valid = found.vector.flatten(-2), found.valid.flatten(-2)
    sizes = []
    for axis in axes.unbind(-1):
        along = torch.stack([axis[..., i, None] * vector[i] for i in range(AXES)]).sum(0).abs()
        sizes.append(quantile(along, valid, 0.5)[..., 0] / NORMAL)
    return torch.stack(sizes, -1)
