"""What a frame should be, judged by those around it: the best linear prediction, for any gaps.

A motion is taken as a Gaussian process with the spectrum ``1 / (f0^2 + f^2)^3``, seen with white
noise. The prediction of a frame from those within four frames to each side then depends on which of
them are present only: 256 patterns, solved once and looked up.
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import lowest
from torchquat._running import running_maximum, running_product
from torchquat._series import squared_arcsine
from torchquat.filters._rows import all_places, places, shifted

__all__ = [
    "LEVELS",
    "REACH",
    "Around",
    "Prediction",
    "aligned",
    "around",
    "neighbours",
    "predict",
    "squared_angle_of",
    "squared_errors",
]

REACH = 4
"""Frames to each side that a prediction reads."""
LEVELS = (1.0, 10.0, 100.0, 1e3, 1e4)
"""Power of the noise, over that of the error of a prediction without noise."""
CORNER, DECAY = 0.01, 3  # of the spectrum: [1 / frame], and half its exponent
LAGS = (*range(-REACH, 0), *range(1, REACH + 1))


def _solved() -> tuple[np.ndarray, np.ndarray]:
    """Weights ``(levels * patterns, lags)``, and the variance of what a prediction misses."""
    frequency = (np.arange(2000) + 0.5) / 4000
    power = (CORNER**2 + frequency**2) ** -float(DECAY)
    lag = np.array(LAGS, dtype=np.int64)
    kernel = np.cos(2 * np.pi * np.arange(2 * REACH + 1)[:, None] * frequency) @ power
    among, ahead = kernel[np.abs(lag[:, None] - lag)], kernel[np.abs(lag)]
    unit = kernel[0] - ahead @ np.linalg.solve(among, ahead)
    present = (np.arange(2 ** len(LAGS))[:, None] >> np.arange(len(LAGS))) & 1
    both = present[:, :, None] * present[:, None, :]
    diagonal = np.eye(len(LAGS))
    weights, variances = [], []
    for level in LEVELS:
        absent = (1 - present)[:, :, None] * diagonal
        system = both * (among + level * unit * diagonal) + absent
        weight = np.linalg.solve(system, (present * ahead)[..., None])[..., 0]
        weights.append(weight)
        variances.append((kernel[0] - weight @ ahead) / unit + level)
    variance = np.array(variances)
    return np.concatenate(weights), (variance / variance[:, -1:]).ravel()


_WEIGHTS, _VARIANCES = (torch.from_numpy(table) for table in _solved())
_ALL = 2 ** len(LAGS) - 1  # the pattern with all neighbours, whose weights are symmetric in time


class Around(NamedTuple):
    """What predictions of a row read, whatever the level of noise.

    Attributes:
        q: Unit quaternions ``(4, N, T)``.
        pairs: Sums of what lies 1, 2, ... frames before and after; ``None`` if no prediction has
            all neighbours.
        at: Places ``(P,)`` of all that may lack neighbours, as if rows lay one after the other.
        near: Their neighbours ``(4, P, lags)``.
        pattern: Which of these are there ``(P,)``.
    """

    q: Tensor
    pairs: list[Tensor] | None
    at: Tensor
    near: Tensor
    pattern: Tensor


class Prediction(NamedTuple):
    """Predicted rotations, and how surely.

    Attributes:
        q: Quaternions ``(4, N, T)``, nearly of unit length where motion is smooth.
        variance: Squared error to be expected, over that with all neighbours present ``(N, T)``.
    """

    q: Tensor
    variance: Tensor


def around(q: Tensor, present: Tensor) -> Around:
    """Gather what predictions read.

    Args:
        q: Unit quaternions ``(4, N, T)``, those present in one hemisphere with the next.
        present: Booleans ``(N, T)``: which frames to read.
    """
    near = shifted(present, REACH)
    at = places(~reduce(torch.logical_and, [near[REACH + lag] for lag in LAGS]))
    pairs = None
    if at is None:
        at = all_places(present)
    else:
        planes = shifted(q, REACH)
        pairs = [planes[REACH - lag] + planes[REACH + lag] for lag in range(1, REACH + 1)]
    beside, there = neighbours(q, present, at)
    bits = there.to(torch.int64) << torch.arange(len(LAGS), device=q.device)
    return Around(q, pairs, at, beside, bits.sum(-1))


def neighbours(q: Tensor, present: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
    """Quaternions ``(4, P, lags)`` beside places ``(P,)``, and which of them are there."""
    frames = q.shape[-1]
    lags = torch.tensor(LAGS, device=q.device)
    frame = (at % frames)[:, None] + lags
    within = (frame >= 0) & (frame < frames)
    source = torch.where(within, at[:, None] + lags, 0).flatten()
    near = q.flatten(1).index_select(1, source).reshape(4, *frame.shape)
    return near, within & present.flatten().index_select(0, source).reshape(frame.shape)


def predict(known: Around, level: Tensor) -> Prediction:
    """Predict every frame from its neighbours, without itself.

    The weighted mean of quaternions: it commutes with every isometry of the 3-sphere.

    Args:
        known: From :func:`around`.
        level: Index into ``LEVELS``, ``(N, 1)``.

    Returns:
        Predictions; a frame without neighbours keeps itself.
    """
    size, count = known.q.shape[1:], 2 ** len(LAGS)
    index = known.pattern + (level.expand(size).flatten().index_select(0, known.at) * count)
    weights = torch.nn.functional.embedding(index, _WEIGHTS.to(known.q))
    mean, variance = (weights * known.near).sum(-1), _VARIANCES.to(known.q)[index]
    own = known.q.flatten(1).index_select(1, known.at)
    mean = torch.where(mean.square().sum(0) > 1e-6, mean, own)
    if known.pairs is None:
        return Prediction(mean.reshape(known.q.shape), variance.reshape(size))
    whole = _WEIGHTS.to(known.q)[level * count + _ALL, REACH:]  # (N, 1, REACH)
    total = whole[..., 0] * known.pairs[0]
    for weight, pair in zip(whole.unbind(-1)[1:], known.pairs[1:], strict=True):
        total = torch.addcmul(total, weight, pair)
    total = total.flatten(1).index_copy(1, known.at, mean).reshape(known.q.shape)
    ones = torch.ones_like(known.q[0]).flatten()
    return Prediction(total, ones.index_copy(0, known.at, variance).reshape(size))


def squared_errors(prediction: Tensor, q: Tensor) -> Tensor:
    r"""Squared angles between predictions, of any length, and unit quaternions, ``(4, N, T)``.

    From the tangent of half the angle, which needs no unit length.
    """
    away = prediction - q  # exact where they are near
    along = _planes.dot(away.unbind(0), q.unbind(0))
    across = (_planes.dot(away.unbind(0), away.unbind(0)) - along.square()).clamp(min=0.0)
    return squared_angle_of(across / (1.0 + along).square())


def squared_angle_of(tangent: Tensor) -> Tensor:
    """Squared angle of the squared tangent of its half, both at most those of a half turn."""
    tangent = tangent.clamp(max=1e12)
    whole = 1.0 + tangent
    return 16.0 * squared_arcsine(0.5 * tangent / (whole + whole.sqrt()))


def aligned(q: Tensor, good: Tensor) -> Tensor:
    """Choose the signs so that every frame lies in the hemisphere of the last good one before.

    Args:
        q: Unit quaternions ``(4, N, T)``.
        good: Booleans ``(N, T)``.

    Returns:
        Unit quaternions ``(4, N, T)``.
    """
    frame = torch.arange(q.shape[-1], device=q.device).expand(good.shape)
    latest = running_maximum(torch.where(good, frame, 0), -1)
    earlier = (torch.arange(q.shape[-1], device=q.device) - 1).clamp(min=0)
    before = latest.index_select(-1, earlier)
    there = q.detach().gather(-1, before.expand(q.shape))
    cosine = _planes.dot(q.detach().unbind(0), there.unbind(0))
    if lowest(cosine) >= 0:
        return q
    step = _planes.sign_of(cosine)
    chain = running_product(torch.where(good, step, 1.0), -1)
    return q * (chain.index_select(-1, earlier) * step)
