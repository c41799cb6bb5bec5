"""Which samples are wrong, not only noisy: found by what their neighbours predict.

A sample is an outlier if it lies further from the prediction than the motion around it explains.
What is flagged is left out of the predictions of its neighbours, which are then judged again.
"""

import math
from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import visible
from torchquat._operations import squared_angle
from torchquat.filters._kriging import (
    LEVELS,
    REACH,
    aligned,
    around,
    neighbours,
    predict,
    squared_angle_of,
    squared_errors,
)
from torchquat.filters._rows import all_places, places, quaternions_of, rows_of, shifted

__all__ = ["Found", "find_outliers"]

BLOCK = 2**15
"""Samples that are judged at a time."""
DOUBTFUL, LARGEST_ANGLE = 0.7, 3.0  # share of the least error to be flagged; [rad]
PASSES = 5
NEAR = 4  # frames to each side that the size of the errors is taken from
RIVALS = 3  # frames to each side: of two outliers as near, the larger one is flagged first
FLOOR = 0.002  # [rad]: no motion is more regular
TRUST = 3.0  # samples that the mean over the whole joint counts for
FIRST = 2.5  # errors further from the first guess are flagged, for the time being
THRESHOLD, AT, SLOPE = 2.4, 0.12, 0.4  # of errors of 0.12 rad; larger for smaller ones
LARGEST = 12.0
LEAST = 0.05  # [rad]: smaller ones do no harm
BACK = 0.9  # flagged samples come back below this share of the threshold
# outliers beyond doubt: further off than motion with its bursts goes, or than noise does
CLEAR, CLEAR_OF_NOISE, CLEAR_ANGLE = 3.0, 2.0, 0.35
FEW, MANY = 0.006, 0.02  # share of samples beyond doubt, from which on lesser ones are believed
TAIL = 3.0  # known noise goes no further, in root mean squares
GESTURE = 0.5  # share of the angle across a gap that a gesture may be off what is predicted
NOISY = 2  # level of noise from which on errors are noise, not motion
GUESSES = (
    {-1: 1 / 2, 1: 1 / 2},
    {-2: -1 / 6, -1: 2 / 3, 1: 2 / 3, 2: -1 / 6},
    {-2: -1.0, -1: 2.0},
    {1: 2.0, 2: -1.0},
    {-1: 2 / 3, 2: 1 / 3},
    {-2: 1 / 3, 1: 2 / 3},
    {-2: -1 / 3, -1: 1.0, 2: 1 / 3},
    {-2: 1 / 3, 1: 1.0, 2: -1 / 3},
)
"""Weights by lag of the first guesses: one of them leaves out an outlier among the neighbours."""


class Found(NamedTuple):
    """Which samples are good, ``(..., T, J)``, and the joints' levels of noise, ``(..., 1, J)``."""

    good: Tensor
    level: Tensor


class _Joints(NamedTuple):
    """Joints as rows, and what is believed of them for the time being.

    Attributes:
        q: Unit quaternions ``(4, N, T)``.
        present: Booleans ``(N, T)``.
        good: Booleans ``(N, T)``.
        level: Index into ``LEVELS``, ``(N, 1)``.
        noise: Root mean square angle of known noise, ``(N, 1)`` [rad].
    """

    q: Tensor
    present: Tensor
    good: Tensor
    level: Tensor
    noise: Tensor

    def at(self, rows: Tensor) -> "_Joints":
        """Only some of them."""
        known = (x.index_select(0, rows) for x in self[1:])
        return _Joints(self.q.index_select(1, rows), *known)

    def with_signs(self) -> "_Joints":
        """Signs chosen along what is good."""
        return self._replace(q=aligned(self.q, self.good))


def find_outliers(q: Tensor, present: Tensor, sigma: Tensor | None = None) -> Found:
    """Tell good samples from wrong ones.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; without a gradient.
        present: Booleans ``(..., T, J)``.
        sigma: Known noise, broadcastable to ``(..., 1, J)`` [rad].

    Returns:
        What was found. Levels are sought only where frames are missing or may be wrong.
    """
    noise = torch.zeros_like(q[..., :1, :, 0])
    if sigma is not None:
        noise = noise + math.sqrt(3.0) * sigma
    there = rows_of(present)
    level = torch.ones_like(there[:, :1], dtype=torch.int64)
    joints = _Joints(quaternions_of(q), there, there, level, rows_of(noise))
    every = torch.arange(there.shape[0], device=q.device)
    together = max(BLOCK // there.shape[1], 1)
    groups = every.split(together) if visible(there) else [every]
    parts = [_found(joints.at(rows)) for rows in groups]
    good, level = (torch.cat(x) for x in zip(*parts, strict=True))
    return Found(*(x.reshape(*q.shape[:-3], q.shape[-2], -1).mT for x in (good, level)))


def _found(joints: _Joints) -> tuple[Tensor, Tensor]:
    """What is good, and the level of noise."""
    joints = joints.with_signs()
    doubtful = _doubtful(joints)
    rows = places(doubtful)
    if rows is None:
        good, level = _examined(joints)
        return torch.where(doubtful[:, None], good, joints.good), level
    if rows.numel() == 0:
        return joints.good, joints.level
    good, level = _examined(joints.at(rows))
    return joints.good.index_copy(0, rows, good), joints.level.index_copy(0, rows, level)


def _doubtful(joints: _Joints) -> Tensor:
    """Which rows have missing frames, or any that lies not far from being flagged.

    As the neighbours are judged by, a wrong sample shows also before it is known which are.
    """
    prediction = predict(around(joints.q, joints.good), joints.level).q.unbind(0)
    along = _planes.dot(prediction, joints.q.unbind(0))
    square = _planes.dot(prediction, prediction)
    near = torch.cos(0.5 * (DOUBTFUL * _sure(joints.noise)).clamp(max=LARGEST_ANGLE)).square()
    off = along * along.abs() < near * square
    return (off | ~joints.present).any(-1)


def _sure(noise: Tensor) -> Tensor:
    """Errors below it are never flagged in rows without larger ones."""
    return (TAIL * noise).clamp(min=CLEAR_ANGLE)


def _examined(joints: _Joints) -> tuple[Tensor, Tensor]:
    """What is good in the end, and the level of noise."""
    joints = joints._replace(good=_first(joints)).with_signs()
    joints = joints._replace(good=_judged(joints)).with_signs()
    joints = joints._replace(level=_level(joints))
    return _settled(joints, PASSES - 1), joints.level


def _settled(joints: _Joints, passes: int) -> Tensor:
    """Judge again what has changed."""
    joints = joints.with_signs()
    good = _judged(joints)
    rows = places((good != joints.good).any(-1))
    joints = joints._replace(good=good)
    if passes == 1:
        return good
    if rows is None:
        return _settled(joints, passes - 1)
    if rows.numel() == 0:
        return good
    return good.index_copy(0, rows, _settled(joints.at(rows), passes - 1))


def _first(joints: _Joints) -> Tensor:
    """Flag what no first guess comes near to."""
    near = [_held(plane) for plane in joints.q.unbind(0)]
    missing = _held(torch.where(joints.present, 0.0, torch.inf).to(joints.q))
    least = torch.full_like(joints.q[0], torch.inf)
    for guess in GUESSES:
        away = [
            reduce(torch.add, [w * lags[2 + lag] for lag, w in guess.items()], -lags[2])
            for lags in near
        ]
        along = _planes.dot(away, joints.q.unbind(0))
        across = (_planes.dot(away, away) - along.square()).clamp(min=0.0)
        off = across / (1.0 + along).square()
        least = torch.minimum(least, reduce(torch.add, [missing[2 + lag] for lag in guess], off))
    known = joints.present & least.isfinite()
    root = torch.where(known, squared_angle_of(least), 0.0).sqrt()
    size = _size(root.sqrt(), known).square()
    floor = joints.noise.clamp(min=FLOOR)
    return joints.present & ~(root > FIRST * (size.square() + floor.square()).sqrt())


def _held(x: Tensor) -> list[Tensor]:
    """Two frames to each side ``(N, T)``, those at the ends held."""
    first, last = x[:, :1], x.narrow(-1, x.shape[-1] - 1, 1)
    padded = torch.cat([first, first, x, last, last], -1)
    return [padded.narrow(-1, start, x.shape[-1]) for start in range(5)]


def _level(joints: _Joints) -> Tensor:
    """The level of noise whose predictions come nearest to the joint's good samples."""
    known = around(joints.q, joints.good)
    level = torch.zeros_like(joints.level)
    best = torch.full_like(joints.noise, torch.inf)
    for index in range(len(LEVELS)):
        here = torch.full_like(level, index)
        off = squared_errors(predict(known, here).q, joints.q)
        mean = _mean(off.sqrt().sqrt(), joints.good).square()
        nearer = mean < 0.98 * best
        best, level = torch.where(nearer, mean, best), torch.where(nearer, here, level)
    return level


def _judged(joints: _Joints) -> Tensor:
    """Flag the largest errors, and take back what has become likely."""
    prediction = predict(around(joints.q, joints.good), joints.level)
    error = squared_errors(prediction.q, joints.q).sqrt()
    # below, nothing is flagged, and what was comes back
    rows = places(error.amax(-1, keepdim=True) >= BACK * _sure(joints.noise))
    if rows is None:
        return _flagged(joints, error, prediction.variance)
    if rows.numel() == 0:
        return joints.present
    parts = (x.index_select(0, rows) for x in (error, prediction.variance))
    return joints.present.index_copy(0, rows, _flagged(joints.at(rows), *parts))


def _flagged(joints: _Joints, error: Tensor, variance: Tensor) -> Tensor:
    """What is good by these errors."""
    _, present, good, level, noise = joints
    size = _size(error.square() / variance, good)
    expected = ((size + noise.clamp(min=FLOOR).square()) * variance).sqrt()
    limit = expected * (THRESHOLD * (AT / expected) ** SLOPE).clamp(max=LARGEST)
    clear = torch.where(level >= NOISY, CLEAR_OF_NOISE, CLEAR) * limit
    clear = clear.clamp(min=CLEAR_ANGLE)
    share = _mean((error > clear).to(error.dtype), present)
    believed = ((share - FEW) / (MANY - FEW)).clamp(0.0, 1.0)
    limit = limit.clamp(min=LEAST) ** believed * clear ** (1.0 - believed)
    limit = torch.maximum(limit, TAIL * noise * variance.sqrt())
    excess = error / torch.maximum(limit, GESTURE * _across(joints, error >= BACK * limit))
    rated = torch.where(good, excess, 0.0)
    largest = reduce(torch.maximum, shifted(rated, RIVALS))
    wrong = (rated > 1.0) & (rated >= largest)
    return (good & ~wrong) | (present & ~good & (excess < BACK))


def _across(joints: _Joints, wanted: Tensor) -> Tensor:
    """Angle between the good samples before and after each; 0 where a side has none near."""
    at = places(wanted)
    at = all_places(wanted) if at is None else at
    near, there = neighbours(joints.q, joints.good, at)
    before = _nearest(near[..., :REACH].flip(-1), there[:, :REACH].flip(-1))
    after = _nearest(near[..., REACH:], there[:, REACH:])
    both = there[:, :REACH].any(-1) & there[:, REACH:].any(-1)
    angle = squared_angle(_planes.components(before), _planes.components(after)).sqrt()
    across = torch.where(both, angle, 0.0)
    return torch.zeros_like(joints.q[0]).flatten().index_copy(0, at, across).reshape(wanted.shape)


def _nearest(near: Tensor, there: Tensor) -> Tensor:
    """The first that is there, ``(4, P)`` of ``(4, P, lags)``."""
    place = there.to(torch.uint8).argmax(-1, keepdim=True)
    return near.gather(-1, place.expand(4, *place.shape))[..., 0]


def _size(x: Tensor, good: Tensor) -> Tensor:
    """Mean of the good samples around each but itself, drawn to that of the whole joint."""
    counted = good.to(x.dtype)
    kept = counted * x
    total = sum(shifted(kept, NEAR)) - kept
    count = sum(shifted(counted, NEAR)) - counted
    overall = _mean(x.sqrt(), good).square()
    return (total.clamp(min=0.0) + TRUST * overall) / (count + TRUST)


def _mean(x: Tensor, good: Tensor) -> Tensor:
    """Mean over time of what is good, ``(N, 1)``; 0 of nothing."""
    total = (good.to(x.dtype) * x).sum(-1, keepdim=True)
    return total / good.sum(-1, keepdim=True).clamp(min=1)
