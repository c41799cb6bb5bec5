"""Which samples are wrong, not only noisy: found by what their neighbours predict.

A sample is an outlier if it lies further from the prediction than the motion around it explains.
What is flagged is left out of the predictions of its neighbours, which are then judged again.
"""

import math
from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import so3
from torchquat.filters._kriging import LEVELS, REACH, aligned, predict, spread

__all__ = ["Found", "find_outliers"]

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
    """Signs chosen along what is good, which samples are, and the joints' levels of noise."""

    q: Tensor
    good: Tensor
    level: Tensor


def find_outliers(q: Tensor, present: Tensor, sigma: Tensor | None = None) -> Found:
    """Tell good samples from wrong ones.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; without a gradient.
        present: Booleans ``(..., T, J)``.
        sigma: Known noise, broadcastable to ``(..., 1, J)`` [rad].

    Returns:
        What was found.
    """
    noise = torch.zeros_like(q[..., :1, :, 0])
    if sigma is not None:
        noise = noise + math.sqrt(3.0) * sigma
    floor = noise.clamp(min=FLOOR)
    q = aligned(q, present)
    good = _first(q, present, floor)
    level = torch.ones_like(good[..., :1, :], dtype=torch.int64)
    for turn in range(PASSES):
        q = aligned(q, good)
        if turn == 1:
            level = _level(q, good)
        good = _judged(q, present, good, level, floor, noise)
    return Found(aligned(q, good), good, level)


def _first(q: Tensor, present: Tensor, floor: Tensor) -> Tensor:
    """Flag what no first guess comes near to."""
    around = [spread(plane, 2, hold=True) for plane in q.unbind(-1)]
    there = spread(present, 2, hold=True)
    error = torch.full_like(q[..., 0], torch.inf)
    for guess in GUESSES:
        mean = torch.stack(
            [reduce(torch.add, [w * near[2 + lag] for lag, w in guess.items()]) for near in around],
            -1,
        )
        known = reduce(torch.logical_and, [there[2 + lag] for lag in guess])
        off = so3.squared_distance(so3.normalize(mean), q)
        error = torch.where(known, torch.minimum(error, off), error)
    known = present & error.isfinite()
    root = torch.where(known, error, 0.0).sqrt()
    size = _size(root.sqrt(), known).square()
    return present & ~(root > FIRST * (size.square() + floor.square()).sqrt())


def _level(q: Tensor, good: Tensor) -> Tensor:
    """The level of noise whose predictions come nearest to the joint's good samples."""
    best = level = None
    for index in range(len(LEVELS)):
        here = torch.full_like(good[..., :1, :], index, dtype=torch.int64)
        off = so3.squared_distance(predict(q, good, here).q, q).sqrt().sqrt()
        mean = _mean(off, good).square()
        if best is None or level is None:
            best, level = mean, here
        else:
            nearer = mean < 0.98 * best
            best, level = torch.where(nearer, mean, best), torch.where(nearer, here, level)
    assert level is not None
    return level


def _judged(
    q: Tensor, present: Tensor, good: Tensor, level: Tensor, floor: Tensor, noise: Tensor
) -> Tensor:
    """Flag the largest errors, and take back what has become likely."""
    prediction = predict(q, good, level)
    square = so3.squared_distance(prediction.q, q)
    size = _size((square / prediction.variance), good)
    error, expected = square.sqrt(), ((size + floor.square()) * prediction.variance).sqrt()
    limit = expected * (THRESHOLD * (AT / expected) ** SLOPE).clamp(max=LARGEST)
    clear = torch.where(level >= NOISY, CLEAR_OF_NOISE, CLEAR) * limit
    beyond = present & (error > clear.clamp(min=CLEAR_ANGLE))
    share = _mean(beyond.to(q.dtype), present)
    believed = ((share - FEW) / (MANY - FEW)).clamp(0.0, 1.0)
    limit = limit.clamp(min=LEAST) ** believed * clear.clamp(min=CLEAR_ANGLE) ** (1.0 - believed)
    never = torch.maximum(TAIL * noise * prediction.variance.sqrt(), GESTURE * _across(q, good))
    excess = error / torch.maximum(limit, never)
    rated = torch.where(good, excess, 0.0)
    largest = reduce(torch.maximum, spread(rated, RIVALS))
    wrong = (rated > 1.0) & (rated >= largest)
    return (good & ~wrong) | (present & ~good & (excess < BACK))


def _across(q: Tensor, good: Tensor) -> Tensor:
    """Angle between the good samples before and after each; 0 where a side has none near."""
    before, after = _nearest(q, good, -1), _nearest(q, good, 1)
    known = (before.square().sum(-1) > 0) & (after.square().sum(-1) > 0)
    return torch.where(known, so3.squared_distance(before, after), 0.0).sqrt()


def _nearest(q: Tensor, good: Tensor, side: int) -> Tensor:
    """The good samples next to each on one side; zeros where there is none in reach."""
    there = spread(good, REACH)
    planes = []
    for plane in q.unbind(-1):
        near, nearest = spread(plane, REACH), torch.zeros_like(plane)
        for lag in range(REACH, 0, -1):
            place = REACH + side * lag
            nearest = torch.where(there[place], near[place], nearest)
        planes.append(nearest)
    return torch.stack(planes, -1)


def _size(x: Tensor, good: Tensor) -> Tensor:
    """Mean of the good samples around each but itself, drawn to that of the whole joint."""
    kept = torch.where(good, x, 0.0)
    total = sum(spread(kept, NEAR)) - kept
    count = sum(spread(good.to(x.dtype), NEAR)) - good.to(x.dtype)
    overall = _mean(x.sqrt(), good).square()
    return (total.clamp(min=0.0) + TRUST * overall) / (count + TRUST)


def _mean(x: Tensor, good: Tensor) -> Tensor:
    """Mean over time of what is good, ``(..., 1, J)``; 0 of nothing."""
    total = torch.where(good, x, 0.0).sum(-2, keepdim=True)
    return total / good.sum(-2, keepdim=True).clamp(min=1)
