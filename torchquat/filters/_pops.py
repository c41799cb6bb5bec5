"""Stretches of a joint that stand beside its motion: jumps that soon jump back, undone.

A displaced stretch keeps its shape, ``q_t exp(v)``: it is moved back, not filled.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import _eager, so3
from torchquat.filters._kriging import spread

__all__ = ["undone"]

LONGEST, LONGEST_AT_END = 24, 15  # [frames] from a jump to the one back
SHORTEST = 2  # single samples are found otherwise
NEAR = 8  # frames to each side that the size of the usual excess is taken from
LIKELY = 3.0  # the same, for leaving out what may be one where the usual is measured
RATIO, RATIO_AT_END = 12.0, 24.0  # jumps stand out of the usual excess that far
LEAST, LEAST_AT_END = 0.3, 0.5  # [rad]: smaller jumps are left
GESTURE = 1.0  # share of the steps before and after that a gesture's excess stays below
TAIL = 3.0  # noise goes no further, in root mean squares
EXCESS = math.sqrt(5.0)  # root mean square of white noise in an excess, per axis and sigma
CLOSED = 0.3  # share of the first jump, or ...
CLOSED_MOTION = 2.0  # ... multiple of the usual excess that a way there and back may be open


class _Jumps(NamedTuple):
    """What every step has in excess of those beside it, and which are jumps.

    Attributes:
        excess: Unit quaternions ``(..., T, J, 4)``, of the step that ends in a frame; the identity
            where it is no jump.
        angle: Its angle [rad] ``(..., T, J)``.
        usual: Size of the excess in the frames around.
        inside: Whether it is a jump.
        ending: Whether it is one even without another that leads back.
    """

    excess: Tensor
    angle: Tensor
    usual: Tensor
    inside: Tensor
    ending: Tensor


def undone(q: Tensor, present: Tensor, noise: Tensor) -> Tensor:
    r"""Move displaced stretches of up to 15 frames back.

    The excess of a step :math:`s_t = q_{t-1}^{-1} q_t` over half of those before and after,

    .. math::
        x_t = s_{t-1}^{-1/2}\, s_t\, s_{t+1}^{-1/2},

    is about :math:`d` where a stretch begins that is displaced by :math:`d`, and its inverse where
    it ends. Jumps are excesses that neither the motion around them nor the steps beside them
    explain. From each, their product is followed until it comes back to about the identity; then it
    is the displacement, and what is left is spread evenly over the stretch. The first and the last
    stretch may reach beyond the sequence.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        present: Booleans ``(..., T, J)``.
        noise: Standard deviation of the noise, ``(..., 1, J)`` [rad].

    Returns:
        Unit quaternions ``(..., T, J, 4)``; what was displaced is constant to gradients of
        everything but itself.
    """
    with torch.no_grad():
        plain = q.detach()
        jumps = _jumps(plain, present, noise)
        if _eager.highest(jumps.inside.to(q.dtype)) == 0.0:
            return q
        away = _displacement(jumps)
        tail = so3.compose(plain, so3.inverse(away)).flip(-3)
        head = _displacement(_jumps(tail, present.flip(-2), noise)).flip(-3)
        away = so3.compose(head, away)
    moved = (away[..., :3].square().sum(-1) > 0)[..., None]
    return torch.where(moved, so3.compose(q, so3.inverse(away)), q)


def _displacement(jumps: _Jumps) -> Tensor:
    """Displacements ``(..., T, J, 4)``, the identity where a frame is in its place."""
    length, rest = _ways_back(jumps)
    frame = torch.arange(length.shape[-2], device=length.device)[:, None]
    # the earliest way back wins: it covers what begins on it
    covered = torch.where(length > 0, frame + length, 0).cummax(-2).values
    begun = _shifted(covered, -1, 0) < frame
    length = torch.where(begun, length, 0)
    way = jumps.excess
    result = _identity(way)
    for lag in range(LONGEST):
        if lag > 0:
            way = so3.compose(way, _shifted(jumps.excess, lag, 1))
        share = (lag + 0.5) / length.clamp(min=1).to(way.dtype)
        here = so3.compose(so3.exp(-share[..., None] * rest), way)
        result = torch.where(
            _shifted(length > lag, -lag, 0)[..., None], _shifted(here, -lag, 1), result
        )
    return result


def _ways_back(jumps: _Jumps) -> tuple[Tensor, Tensor]:
    """Frames from every jump until jumps have led back, 0 for never; and the rotation vectors left.

    A way that the sequence ends on is taken to lead back behind it.
    """
    frames = jumps.angle.shape[-2]
    frame = torch.arange(frames, device=jumps.angle.device)[:, None]
    length = torch.zeros_like(jumps.inside, dtype=torch.int64)
    way = jumps.excess
    rest = torch.zeros_like(way[..., :3])
    tolerance = torch.maximum(CLOSED * jumps.angle, CLOSED_MOTION * jumps.usual)
    for lag in range(1, LONGEST + 1):
        way = so3.compose(way, _shifted(jumps.excess, lag, 1))
        left = so3.log(way)
        back = jumps.inside & _shifted(jumps.inside, lag, 0) & (lag >= SHORTEST)
        back = back & (left.square().sum(-1) < tolerance.square())
        rest = torch.where((back & (length == 0))[..., None], left, rest)
        if lag <= LONGEST_AT_END:
            back = back | (jumps.ending & (frame + lag == frames) & (3 * lag < frames))
        length = torch.where(back & (length == 0), lag, length)
    return length, rest


def _jumps(q: Tensor, present: Tensor, noise: Tensor) -> _Jumps:
    frames = q.shape[-3]
    frame = torch.arange(frames, device=q.device)[:, None]
    step = so3.between(_shifted(q, -1, 2), q)
    after = torch.where((frame < frames - 1)[..., None], _shifted(step, 1, 2), 0.0)
    before = torch.where((frame > 1)[..., None], _shifted(step, -1, 2), 0.0)
    # at the ends one neighbour stands for both
    before, after = (
        torch.where((frame > 1)[..., None], before, after),
        torch.where((frame < frames - 1)[..., None], after, before),
    )
    excess = so3.compose(so3.compose(so3.exp(-0.5 * before), so3.exp(step)), so3.exp(-0.5 * after))
    angle = so3.log(excess).norm(dim=-1)
    known = present & _shifted(present, -1, 0) & (frame > 0)
    beside = before.norm(dim=-1) + after.norm(dim=-1)
    usual = _usual(angle, known)
    # a jump adds half of itself to the excess of both neighbours
    likely = known & (angle > LIKELY * usual) & (angle > torch.clamp(GESTURE * beside, min=LEAST))
    near = spread(likely, 1)
    usual = _usual(angle, known & ~(near[0] | near[1] | near[2]))
    limit = torch.maximum(GESTURE * beside, TAIL * EXCESS * math.sqrt(3.0) * noise)
    inside = known & (angle > limit) & (angle > RATIO * usual) & (angle > LEAST)
    ending = inside & (angle > RATIO_AT_END * usual) & (angle > LEAST_AT_END)
    excess = torch.where(inside[..., None], excess, _identity(excess))
    return _Jumps(excess, angle, usual, inside, ending)


def _usual(angle: Tensor, known: Tensor) -> Tensor:
    """Size of what lies around each frame, its next neighbours left out; jumps count little."""
    total, count = (
        sum(near[NEAR + lag] for lag in range(-NEAR, NEAR + 1) if abs(lag) > 1)
        for near in (
            spread(torch.where(known, angle, 0.0).sqrt(), NEAR),
            spread(known.to(angle.dtype), NEAR),
        )
    )
    return (total / count.clamp(min=1.0)).square()


def _identity(q: Tensor) -> Tensor:
    return torch.cat([torch.zeros_like(q[..., :3]), torch.ones_like(q[..., :1])], -1)


def _shifted(x: Tensor, lag: int, kind: int) -> Tensor:
    """``x_{t + lag}``. Beyond the ends: 0 (kind 0), the identity (1), the frame at the end (2)."""
    axis = -2 if kind == 0 else -3
    frames = x.shape[axis]
    source = torch.arange(frames, device=x.device) + lag
    there = x.index_select(axis, source.clamp(min=0).clamp(max=frames - 1))
    if kind == 2:
        return there
    inside = ((source >= 0) & (source < frames))[:, None]
    if kind == 0:
        return torch.where(inside, there, torch.zeros_like(there))
    return torch.where(inside[..., None], there, _identity(there))
