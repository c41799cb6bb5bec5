"""Joints as rows: time last, one joint below the other, so that some can be taken out.

What is done to a row never depends on which others there are.
"""

import math

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import visible

__all__ = ["all_places", "places", "quaternions_of", "rows_of", "shifted", "unrowed"]


def rows_of(x: Tensor) -> Tensor:
    """Rows ``(N, T)`` of ``(..., T, J)``, of all joints of all items."""
    return x.mT.reshape(math.prod(x.shape[:-2]) * x.shape[-1], x.shape[-2])


def quaternions_of(q: Tensor) -> Tensor:
    """Rows ``(4, N, T)`` of quaternions ``(..., T, J, 4)``."""
    return torch.stack([rows_of(plane) for plane in q.unbind(-1)])


def unrowed(rows: Tensor, like: Tensor) -> Tensor:
    """Quaternions ``(..., T, J, 4)``, shaped as ``like``, of rows ``(4, N, T)``."""
    batch, (frames, joints) = like.shape[:-3], like.shape[-3:-1]
    return _planes.join([row.reshape(*batch, joints, frames).mT for row in rows.unbind(0)])


def places(chosen: Tensor) -> Tensor | None:
    """Where it is true, of all places; ``None`` where values may not be looked at."""
    return chosen.flatten().nonzero()[:, 0] if visible(chosen) else None


def all_places(x: Tensor) -> Tensor:
    """Of a tensor as if it were flat."""
    return torch.arange(x.numel(), device=x.device)


def shifted(x: Tensor, reach: int) -> list[Tensor]:
    """``x (..., T)`` at every lag from ``-reach`` to ``reach``; 0 outside the sequence."""
    padded = torch.nn.functional.pad(x, (reach, reach))
    return [padded.narrow(-1, start, x.shape[-1]) for start in range(2 * reach + 1)]
