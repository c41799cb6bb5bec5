"""What a frame should be, judged by those around it: the best linear prediction, for any gaps.

A motion is taken as a Gaussian process with the spectrum ``1 / (f0^2 + f^2)^3``, seen with white
noise. The prediction of a frame from those within four frames to each side then depends on which of
them are present only: 256 patterns, solved once and looked up.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchquat import _planes

__all__ = ["LEVELS", "REACH", "Prediction", "aligned", "predict", "spread"]

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


class Prediction(NamedTuple):
    """Predicted rotations, and how surely.

    Attributes:
        q: Unit quaternions ``(..., T, J, 4)``.
        variance: Squared error to be expected, over that with all neighbours present.
    """

    q: Tensor
    variance: Tensor


def predict(q: Tensor, present: Tensor, level: Tensor) -> Prediction:
    """Predict every frame from its neighbours, without itself.

    The weighted mean of quaternions, made a unit one: it commutes with every isometry of the
    3-sphere.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``, those present in one hemisphere with the next.
        present: Booleans ``(..., T, J)``: which frames to read.
        level: Index into ``LEVELS``, ``(..., 1, J)``.

    Returns:
        Predictions; a frame without neighbours keeps itself.
    """
    bits = spread(present.to(torch.int64), REACH)
    pattern = sum(bits[i] << place for place, i in enumerate(_places()))
    index = pattern + level * 2 ** len(LAGS)
    weights = torch.nn.functional.embedding(index, _WEIGHTS.to(q)).unbind(-1)
    planes = []
    for plane in q.unbind(-1):
        near = spread(plane, REACH)
        planes.append(_planes.dot(weights, [near[i] for i in _places()]))
    mean = _planes.join(planes)
    square = mean.square().sum(-1, keepdim=True)
    lasting = square > 1e-6
    unit = torch.where(lasting, mean, q) * torch.where(lasting, square, 1.0).rsqrt()
    return Prediction(unit, _VARIANCES.to(q)[index])


def _places() -> list[int]:
    """Where the lags stand among ``-REACH .. REACH``."""
    return [lag + REACH for lag in LAGS]


def spread(x: Tensor, reach: int, *, hold: bool = False) -> list[Tensor]:
    """``x (..., T, J)`` at every lag from ``-reach`` to ``reach``.

    Outside the sequence stands 0, or (``hold``) the frame at the edge.
    """
    frames = x.shape[-2]
    if hold and frames > 0:
        before, after = (
            x.narrow(-2, at, 1).expand(*x.shape[:-2], reach, x.shape[-1]) for at in (0, frames - 1)
        )
    else:
        before = after = x.new_zeros((*x.shape[:-2], reach, x.shape[-1]))
    padded = torch.cat([before, x, after], -2)
    return [padded.narrow(-2, start, frames) for start in range(2 * reach + 1)]


def aligned(q: Tensor, good: Tensor) -> Tensor:
    """Choose the signs so that every frame lies in the hemisphere of the last good one before.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        good: Booleans ``(..., T, J)``.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.
    """
    frame = torch.arange(q.shape[-3], device=q.device)[:, None].expand(good.shape)
    latest = torch.where(good, frame, 0).cummax(-2).values
    earlier = (torch.arange(q.shape[-3], device=q.device) - 1).clamp(min=0)
    before = latest.index_select(-2, earlier)
    there = q.detach().gather(-3, before[..., None].expand(q.shape))
    step = _planes.sign_of(_planes.dot(q.detach().unbind(-1), there.unbind(-1)))
    chain = torch.where(good, step, 1.0).cumprod(-2)
    return q * (chain.index_select(-2, earlier) * step)[..., None]
