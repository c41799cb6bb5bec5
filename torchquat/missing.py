"""Missing frames: which they are, and what stands in their place.

A frame of a joint is missing where its weight is 0 (or negative, or not finite), or where its
quaternion has no direction (a component that is not finite, or all of them zero). Missing frames
carry no weight in any filter, and get no gradient.
"""

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_signal
from torchquat._running import running_maximum, running_minimum

__all__ = ["confidence", "fill_missing", "interpolate", "validity", "weight_range"]


def confidence(q: Tensor, weight: Tensor | None = None) -> Tensor:
    """Weight of every frame and joint, 0 where it is missing.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm.
        weight: Confidence or mask, broadcastable to ``(..., T, J)``; ``None`` means 1.

    Returns:
        Finite weights ``(..., T, J)`` >= 0 in the dtype of ``q``: those too small to divide by are
        0, those too large to multiply are cut, see :func:`weight_range`.
    """
    usable = so3.usable(q)
    if weight is None:
        return usable.to(q.dtype)
    weight = weight.to(q.dtype).expand(q.shape[:-1])
    least, most = weight_range(q.dtype)
    present = usable & torch.isfinite(weight) & (weight >= least)
    return torch.where(present, weight, 0.0).clamp(max=most)


def weight_range(dtype: torch.dtype) -> tuple[float, float]:
    """Weights that can be computed with: 1e-31 to 3e15 in float32, 1e-292 to 2e123 in float64."""
    limits = torch.finfo(dtype)
    return limits.tiny / limits.eps, limits.max**0.4


def validity(q: Tensor, weight: Tensor | None = None) -> Tensor:
    """Which frames are present.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm.
        weight: Confidence or mask, broadcastable to ``(..., T, J)``.

    Returns:
        Booleans ``(..., T, J)``: True where the frame is present.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or device does not fit.
    """
    check_signal(q, weight)
    return confidence(q, weight) > 0


def fill_missing(q: Tensor, weight: Tensor | None = None, *, causal: bool = False) -> Tensor:
    """Fill missing frames by geodesic interpolation between the frames around them.

    Ends hold the nearest present frame. A joint that is missing throughout keeps its values, and
    the identity where they have no direction.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm.
        weight: Confidence or mask, broadcastable to ``(..., T, J)``; 0 marks a missing frame.
        causal: Hold the last present frame instead of interpolating towards the next. Only the
            frames before the first present one still look ahead: they hold it.

    Returns:
        Unit quaternions ``(..., T, J, 4)``; frames that are present are only normalised.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or device does not fit.
    """
    check_signal(q, weight)
    work = q.float() if q.dtype.itemsize < 4 else q
    present = confidence(work, weight) > 0
    return interpolate(so3.normalize(work), present, causal=causal).to(q.dtype)


def interpolate(q: Tensor, present: Tensor, *, causal: bool = False) -> Tensor:
    """:func:`fill_missing` for unit quaternions and a known mask, without checks.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        present: Booleans ``(..., T, J)``.
        causal: As in :func:`fill_missing`.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.
    """
    frames = q.shape[-3]
    frame = torch.arange(frames, device=q.device)[:, None].expand(present.shape)
    before = running_maximum(torch.where(present, frame, -1), -2)
    after = running_minimum(torch.where(present, frame, frames).flip(-2), -2).flip(-2)
    # where one side has no present frame, the other stands for both; where none has, the frame
    left = torch.where(before >= 0, before, torch.where(after < frames, after, frame))
    right = left if causal else torch.where(after < frames, after, left)

    fraction = (frame - left) / (right - left).clamp(min=1).to(q.dtype)
    source = torch.where(present[..., None], q, q.detach())  # no gradient to a missing frame
    # gather, not take_along_dim: that one ties an exported program to the length it was traced with
    first = source.gather(-3, left[..., None].expand_as(source))
    second = source.gather(-3, right[..., None].expand_as(source))
    filled = so3.slerp(first, second, fraction[..., None])
    return torch.where(present[..., None], q, filled)
