"""Rotation vectors without jumps: full turns about the axis, where the path asks for them."""

import math

import torch
from torch import Tensor

from torchquat import so3
from torchquat._running import running_maximum, running_product

__all__ = ["continuous_rotvec"]

FULL_TURN = 2.0 * math.pi


def continuous_rotvec(q: Tensor, start: Tensor | None = None) -> Tensor:
    r"""Rotation vectors, each on the branch nearest to that of the frame before.

    A rotation vector is free up to full turns about its own axis, :math:`(\theta + 2 \pi n) u`.
    Those of a smooth path are smooth, through half turns and full turns too. Beyond a half turn no
    branch is continuous where the axis turns by more than 60 degrees between two frames: the
    branch nearest to zero is taken up again there. Frames without a direction keep the axis of the
    frame before; missing ones are passed over.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm; those without a direction are missing, and
            come back as NaN.
        start: Rotation vectors ``(..., J, 3)`` [rad] that the first frame should be near to; rows
            that are not finite, or 0, ask for an angle of at most pi.

    Returns:
        Rotation vectors ``(..., T, J, 3)`` [rad] of any length.
    """
    known = so3.usable(q)
    short = so3.log(so3.normalize(q))
    square = short.square().sum(-1)
    turning = known & (square.detach() > torch.finfo(q.dtype).tiny)
    angle = torch.where(turning, torch.where(turning, square, 1.0).sqrt(), 0.0)

    with torch.no_grad():
        before = torch.zeros_like(short[..., :1, :, :]) if start is None else start[..., None, :, :]
        before = torch.where(torch.isfinite(before).all(-1, keepdim=True), before, 0.0)
        axis, length = _axes(torch.cat([before.detach(), short.detach()], -3), known)
        turns = _full_turns(axis, length)[..., 1:, :]
        axis = axis[..., 1:, :, :]
    stretch = 1.0 + FULL_TURN * turns / torch.where(turning, angle, 1.0)
    standing = FULL_TURN * turns[..., None] * axis
    moving = torch.where(turning[..., None], short * stretch[..., None], standing)
    return torch.where(known[..., None], moving, torch.nan)


def _axes(path: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Unit axes and angles of vectors ``(..., 1 + T, J, 3)``, held where there is none of them."""
    angle = path.norm(dim=-1)
    seen = torch.cat([torch.ones_like(known[..., :1, :]), known], -2)
    moving = angle * angle > torch.finfo(path.dtype).tiny
    unit = path / torch.where(moving, angle, 1.0)[..., None]
    axis = unit.gather(-3, _last(moving)[..., None].expand(path.shape))
    return axis, angle.gather(-2, _last(seen))


def _last(there: Tensor) -> Tensor:
    """Index of the last frame, up to each ``(..., T, J)``, that is there; 0 where none is."""
    frame = torch.arange(there.shape[-2], device=there.device)[:, None].expand(there.shape)
    return running_maximum(torch.where(there, frame, 0), -2)


def _full_turns(axis: Tensor, angle: Tensor) -> Tensor:
    """Full turns to add to each angle ``(..., T, J)``, 0 to the first.

    Frame by frame, ``n = turned + sign * n_before``, with the sign by which the axis changes: a
    running sum of signed steps. Where the axis is another one altogether it starts anew.
    """
    cosine = (axis[..., 1:, :, :] * axis[..., :-1, :, :]).sum(-1)
    turned = torch.round((cosine * angle[..., :-1, :] - angle[..., 1:, :]) / FULL_TURN)
    anew = cosine.abs() < 0.5
    sign = running_product(torch.where(anew | (cosine > 0), 1.0, -1.0).to(angle.dtype), -2)
    total = torch.cat([torch.zeros_like(angle[..., :1, :]), (sign * turned).cumsum(-2)], -2)
    # what had been added up before the last new start does not count
    turns = sign * (total[..., 1:, :] - total.gather(-2, _last(anew)))
    return torch.cat([torch.zeros_like(angle[..., :1, :]), turns], -2)
