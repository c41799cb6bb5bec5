"""Stretches of a joint that stand beside its motion: jumps that soon jump back, undone.

A displaced stretch keeps its shape, ``q_t exp(v)``: it is moved back, not filled.
"""

import math
from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import _eager, _planes, so3
from torchquat._running import doublings, running_maximum, running_minimum
from torchquat.filters._rows import all_places, places, quaternions_of, rows_of, unrowed

__all__ = ["undone"]

LONGEST, LONGEST_AT_END = 24, 15  # [frames] from a jump to the one back
SHORTEST = 2  # single samples are found otherwise
NEAR = 8  # frames to each side that the size of the usual excess is taken from
LIKELY = 3.0  # the same, for leaving out what may be one where the usual is measured
RATIO, RATIO_AT_END = 12.0, 24.0  # jumps stand out of the usual excess that far
LEAST, LEAST_AT_END = 0.3, 0.5  # [rad]: smaller jumps are left
# share of the steps beside it that the excess of a gesture stays below; that of a single wild
# sample is 1.5 of them
GESTURE = 2.0
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
    r"""Move displaced stretches back.

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
    joints = places(_restless(q.detach(), noise))
    if joints is None:
        return _moved_back(q, present, noise)
    if joints.numel() == 0:
        return q
    rows = quaternions_of(q)
    known = (rows, rows_of(present), rows_of(noise))
    columns, there, level = (x.index_select(-2, joints).mT for x in known)
    moved = _moved_back(columns.movedim(0, -1), there, level)
    return unrowed(rows.index_copy(1, joints, moved.movedim(-1, 0).mT), q)


def _restless(q: Tensor, noise: Tensor) -> Tensor:
    """Which joints ``(..., J)`` have a step as long as a jump, by itself and beside its neighbours.

    An excess is no longer than its step and half of those beside it together, of which it is twice
    as long. Chords are up to a tenth shorter than the arcs.
    """
    frames = q.shape[-3] - 1
    here, there = (q.narrow(-3, start, frames).unbind(-1) for start in (0, 1))
    cosine = _planes.dot(here, there).abs()
    arc = 0.499 * (1.0 - 0.5 / GESTURE) * _least(noise)
    long = cosine < torch.cos(arc.clamp(max=0.5 * math.pi))
    chord = (1.0 - cosine).clamp(min=0.0).sqrt()
    near = _spread(chord, 1)
    return (long & (chord >= 0.88 * (GESTURE - 0.5) * (near[0] + near[2]))).any(-2)


def _least(noise: Tensor) -> Tensor:
    """What jumps are larger than, whatever the motion [rad]."""
    return (TAIL * EXCESS * math.sqrt(3.0) * noise).clamp(min=LEAST)


def _moved_back(q: Tensor, present: Tensor, noise: Tensor) -> Tensor:
    with torch.no_grad():
        jumps = _jumps(q.detach(), present, noise)
        if _eager.highest(jumps.inside.to(q.dtype)) == 0.0:
            return q
        away = _displacement(jumps)
    moved = (away[..., :3].square().sum(-1) > 0)[..., None]
    return torch.where(moved, so3.compose(q, so3.inverse(away)), q)


def _displacement(jumps: _Jumps) -> Tensor:
    """Displacements ``(..., T, J, 4)``, the identity where a frame is in its place."""
    frames = jumps.inside.shape[-2]
    frame = torch.arange(frames, device=jumps.inside.device)[:, None]
    at = places(jumps.inside)
    at = all_places(jumps.inside) if at is None else at
    back, rest = _ways_back(jumps, at)
    dense = torch.zeros_like(jumps.inside, dtype=torch.int64).flatten().scatter(0, at, back)
    back = _first_come(dense.view(jumps.inside.shape))
    covered = running_maximum(torch.where(back > 0, frame + back, -1), -2)
    free = jumps.ending & (covered < frame)
    ahead = _first_come(back + _to_the_end(free))
    away = _placed(jumps.excess, ahead.flatten()[at], rest, at)

    # the same with time reversed, for what begins before the sequence
    source = (frames - torch.arange(frames, device=frame.device)).clamp(max=frames - 1)
    free = free.index_select(-2, source)
    ahead = _first_come(_to_the_end(free))
    at = places(free)
    at = all_places(free) if at is None else at
    reverse = so3.inverse(jumps.excess.index_select(-3, source))
    nothing = torch.zeros_like(rest[:1]).expand(at.shape[0], 3)
    head = _placed(reverse, ahead.flatten()[at], nothing, at)
    return so3.compose(head.flip(-3), away)


def _first_come(length: Tensor) -> Tensor:
    """Of stretches the first, then each time the first that begins behind the end of the last."""
    frames = length.shape[-2]
    frame = torch.arange(frames + 1, device=length.device)[:, None]
    longer = torch.nn.functional.pad(length, (0, 0, 0, 1))  # what follows the last is `frames`
    coming = running_minimum(torch.where(longer > 0, frame, frames).flip(-2), -2).flip(-2)
    following = coming.gather(-2, (frame + longer + 1).clamp(max=frames))
    taken = frame == coming.narrow(-2, 0, 1)
    for _ in doublings(frames):
        ahead = torch.where(taken, following, frames)
        taken = taken | torch.zeros_like(taken).scatter(-2, ahead, True)
        following = following.gather(-2, following)
    return torch.where(taken.narrow(-2, 0, frames), length, 0)


def _to_the_end(chosen: Tensor) -> Tensor:
    """Frames from there to the end of the sequence; 0 where not chosen, or too far from it."""
    frames = chosen.shape[-2]
    left = frames - torch.arange(frames, device=chosen.device)[:, None]
    return torch.where(chosen & (left <= LONGEST_AT_END) & (3 * left < frames), left, 0)


def _ways_back(jumps: _Jumps, at: Tensor) -> tuple[Tensor, Tensor]:
    """Frames from jumps until others have led back, 0 for never; and the rotation vectors left."""
    angle, usual = jumps.angle.flatten()[at], jumps.usual.flatten()[at]
    inside = jumps.inside.flatten()
    bound = torch.maximum(CLOSED * angle, CLOSED_MOTION * usual).square()
    way, there, within = _ways(jumps.excess, at)
    left = so3.log(way)
    back = within & inside[there] & inside[at][:, None] & (left.square().sum(-1) < bound[:, None])
    back = back & (torch.arange(LONGEST + 1, device=at.device) >= SHORTEST)
    length = back.to(torch.int64).argmax(1)  # the first of them; 0 where there is none
    rest = left.gather(1, length[:, None, None].expand(-1, 1, 3))[:, 0]
    return length, torch.where((length > 0)[:, None], rest, 0.0)


def _placed(excess: Tensor, length: Tensor, rest: Tensor, at: Tensor) -> Tensor:
    """Displacements over stretches from ``at`` on, what is left at their end spread evenly."""
    places = excess[..., 0].numel()
    way, there, _ = _ways(excess, at)
    lag = torch.arange(LONGEST + 1, device=at.device)
    share = (lag + 0.5) / length.clamp(min=1)[:, None].to(way.dtype)
    here = so3.compose(so3.exp(-share[..., None] * rest[:, None]), way)
    row = torch.where(lag < length[:, None], there, places)
    result = _identity(excess).flatten(0, -2)
    result = torch.cat([result, result[:1]])  # the last row takes what is to go nowhere
    return result.index_copy(0, row.flatten(), here.flatten(0, 1))[:-1].view(excess.shape)


def _ways(excess: Tensor, at: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Products of the excesses from ``at`` to every lag, where that is, and if it is within."""
    frames, joints = excess.shape[-3:-1]
    lag = torch.arange(LONGEST + 1, device=at.device)
    within = (at // joints % frames)[:, None] + lag < frames
    there = torch.where(within, at[:, None] + lag * joints, at[:, None])
    way = excess.flatten(0, -2)[there]
    way = torch.where(within[..., None], way, _identity(way))
    reach = 1
    while reach <= LONGEST:  # each holds the last `reach` factors: twice as many, ...
        before = torch.cat([_identity(way[:, :reach]), way[:, :-reach]], 1)
        way = so3.compose(before, way)
        reach *= 2
    return way, there, within


def _jumps(q: Tensor, present: Tensor, noise: Tensor) -> _Jumps:
    frames = q.shape[-3]
    frame = torch.arange(frames, device=q.device)
    earlier, later = (frame - 1).clamp(min=0), (frame + 1).clamp(max=frames - 1)
    step = so3.between(q.index_select(-3, earlier), q)
    # at the ends one neighbour stands for both
    before = step.index_select(-3, torch.where(frame > 1, earlier, later))
    after = step.index_select(-3, torch.where(frame < frames - 1, later, earlier))
    halves = (so3.exp(-0.5 * side) for side in (before, after))
    excess = so3.compose(so3.compose(next(halves), so3.exp(step)), next(halves))
    angle = so3.log(excess).norm(dim=-1)
    known = present & present.index_select(-2, earlier) & (frame > 0)[:, None]
    beside = before.norm(dim=-1) + after.norm(dim=-1)
    usual = _usual(angle, known)
    # a jump adds half of itself to the excess of both neighbours
    likely = known & (angle > LIKELY * usual) & (angle > (GESTURE * beside).clamp(min=LEAST))
    near = _spread(likely, 1)
    usual = _usual(angle, known & ~(near[0] | near[1] | near[2]))
    inside = (
        likely & (angle > torch.maximum(GESTURE * beside, _least(noise))) & (angle > RATIO * usual)
    )
    ending = inside & (angle > RATIO_AT_END * usual) & (angle > LEAST_AT_END)
    excess = torch.where(inside[..., None], excess, _identity(excess))
    return _Jumps(excess, angle, usual, inside, ending)


def _usual(angle: Tensor, known: Tensor) -> Tensor:
    """Size of what lies around each frame, its next neighbours left out; jumps count little."""
    root = torch.where(known, angle, 0.0).sqrt()
    total, count = (_around(x) for x in (root, known.to(angle.dtype)))
    return (total / count.clamp(min=1.0)).square()


def _spread(x: Tensor, reach: int) -> list[Tensor]:
    """``x (..., T, J)`` at every lag from ``-reach`` to ``reach``; 0 outside the sequence."""
    padded = torch.nn.functional.pad(x, (0, 0, reach, reach))
    return [padded.narrow(-2, start, x.shape[-2]) for start in range(2 * reach + 1)]


def _around(x: Tensor) -> Tensor:
    """Sum over the frames near each, but itself and those next to it."""
    near = _spread(x, NEAR)
    return reduce(torch.add, near[: NEAR - 1] + near[NEAR + 2 :])


def _identity(q: Tensor) -> Tensor:
    return torch.cat([torch.zeros_like(q[..., :3]), torch.ones_like(q[..., :1])], -1)
