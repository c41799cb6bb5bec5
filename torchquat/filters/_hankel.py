"""Optimal shrinkage of the singular values of Hankel matrices, in overlapping windows of time."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat._eager import visible
from torchquat.filters._local_spectra import times
from torchquat.filters._overlap import blended, centred, cut, frames_of, smaller

__all__ = ["SPAN", "Smoother", "freedom", "smoothed"]

SPAN = 128  # longest stretch of time in one matrix [frames]
AT_A_TIME = 8  # stretches, to bound memory
STEEPEST = 0.1  # least root in a slope, which has no bound where a singular value starts to count


class Smoother(NamedTuple):
    """What the data of overlapping stretches of time have made of a linear smoother.

    Attributes:
        matrix: Of every stretch ``(N stretches, S, S)``; means are kept beside it.
        ratio: How much more than these matrices tell the result follows its data, as they are
            made of them, too, ``(N stretches,)``.
        frame: Frame of each place ``(stretches, S)``.
    """

    matrix: Tensor
    ratio: Tensor
    frame: Tensor


def smoothed(
    x: Tensor, path: Tensor, stack: int, channels: Tensor, span: int | None = None
) -> tuple[Tensor, Smoother]:
    """Bring trajectories seen in white noise of unit power near to what few modes can express.

    Args:
        x: How far the data lie from the path ``(N, T, C)``; derivatives follow it alone.
        path: Path ``(N, T, C)``, counted with the data.
        stack: Consecutive frames in a row of the Hankel matrix.
        channels: How many of the C channels are more than zeros, ``(N,)``.
        span: Longest stretch of time [frames]; ``None``: ``SPAN``.

    Returns:
        What to add to the path ``(N, T, C)``, and the smoother that does, without a gradient.
    """
    frame = _frames(x.shape[1], SPAN if span is None else span, x.device)
    count = channels[:, None].expand(-1, frame.shape[0]).flatten()
    known, seen = centred(cut(path, frame)), cut(x, frame)
    away = centred(seen)
    with torch.no_grad():
        whole = (known + away).detach()  # no_grad lets forward derivatives pass
        smoother = Smoother(*_in_parts(whole, count, stack), frame)
    change = times(smoother.matrix, known + away) + (seen - away) - known
    return _blended(change, smoother, x.shape), smoother


def freedom(smoother: Smoother, shape: torch.Size, colour: Tensor) -> Tensor:
    r"""How far the result of every frame follows its own noise, ``(N, T, 1)``, a channel.

    .. math:: f_a = \sum_b \frac{\partial \hat x_a}{\partial x_b} C_{ab}

    Args:
        smoother: From :func:`smoothed`.
        shape: Of the trajectories ``(N, T, C)``.
        colour: Correlations of the noise at lags from 0 on, ``(N, S)``.
    """
    size = smoother.frame.shape[1]
    slope = smoother.matrix - smoother.matrix.mean(2, keepdim=True)
    slope = smoother.ratio[:, None, None] * slope + 1.0 / size
    place = torch.arange(size, device=slope.device)
    apart = colour[:, (place[:, None] - place).abs()]
    follow = (slope * apart.repeat_interleave(len(smoother.frame), 0)).sum(2, keepdim=True)
    return _blended(follow, smoother, shape)


def _blended(part: Tensor, smoother: Smoother, shape: torch.Size) -> Tensor:
    size = smoother.frame.shape[1]
    middle = (torch.arange(size, device=part.device, dtype=torch.float64) + 0.5) / size
    taper = torch.sin(math.pi * middle).square().to(part.dtype)[:, None]
    return blended(part, taper, smoother.frame, shape)


def _frames(frames: int, span: int, device: torch.device) -> Tensor:
    """Stretches ``(N, S)`` that overlap by half or more."""
    hop, size = span // 2, smaller(frames, span)
    count = 2 * ((frames - size + 3 * hop - 1) // (2 * hop))  # one alone would have another kernel
    return frames_of(count, frames, size, device)


def _in_parts(data: Tensor, count: Tensor, stack: int) -> tuple[Tensor, Tensor]:
    """A few stretches at a time, where nothing but memory depends on how many."""
    parts = data.shape[0] // AT_A_TIME if visible(data) else 1
    split = [y.tensor_split(max(parts, 1)) for y in (data, count)]
    each = [_smoother(x, number, stack) for x, number in zip(*split, strict=True)]
    if len(each) == 1:
        return each[0]
    matrix, ratio = (torch.cat(y) for y in zip(*each, strict=True))
    return matrix, ratio


def _smoother(data: Tensor, count: Tensor, stack: int) -> tuple[Tensor, Tensor]:
    r"""Matrices ``(N, S, S)`` that shrink the Hankel matrix of data and average its diagonals back.

    With :math:`X_k` the rows k to k + R - 1 of the data, the Hankel matrix is
    :math:`H = (X_0, \ldots, X_{K-1})`, and shrinkage multiplies it by the gains :math:`g` of the
    squared singular values, :math:`P = g(H H^T) = g(\sum_k X_k X_k^T)`. Row a of the result is
    the mean of rows a - k of :math:`P X_k`: a sum over the diagonals of P.
    """
    size, exact = data.shape[1], data.double()
    lags = smaller((size + 1) // 2, stack)  # short stretches: about as many rows as lags
    place = torch.arange(size, device=data.device)
    inside = (place <= size - lags).to(exact)
    rows = (inside[:, None] * inside) * _along_diagonals(times(exact, exact.mT), lags, stack, 1)
    power, modes = torch.linalg.eigh(rows)
    gain, ratio = _gains(power, size - lags + 1, lags * count)
    kept = (modes * gain[:, None, :]) @ modes.mT
    kept = (inside[:, None] * inside) * kept
    rows_over = torch.minimum(place + 1, size - place).clamp(max=smaller(lags, size - lags + 1))
    matrix = _along_diagonals(kept, lags, stack, -1) / rows_over[:, None]
    return matrix.to(data.dtype), ratio.to(data.dtype)


def _along_diagonals(matrix: Tensor, lags: int, stack: int, side: int) -> Tensor:
    """Sums of ``matrix[a + side k, b + side k]`` over the lags, of what lies inside."""
    size, reach = matrix.shape[1], stack - 1
    around = (0, reach, 0, reach) if side > 0 else (reach, 0, reach, 0)
    padded = torch.nn.functional.pad(matrix, around)
    counts = (torch.arange(stack, device=matrix.device) < lags).to(matrix)
    total = matrix
    for lag in range(1, stack):
        start = lag if side > 0 else reach - lag
        shifted = padded.narrow(1, start, size).narrow(2, start, size)
        total = torch.addcmul(total, counts[lag], shifted)
    return total


def _gains(power: Tensor, rows: int, columns: Tensor) -> tuple[Tensor, Tensor]:
    r"""Factors of singular values, and how much more freedom they have than constant ones.

    From the squares ``(N, S)`` of singular values y in units of the noise:

    .. math::
        g = \frac{\sqrt{(u - \beta - 1)^2 - 4 \beta}}{u}, \quad u > (1 + \sqrt\beta)^2, \quad
        u = \frac{y^2}{\max(R, C)}, \quad \beta = \frac{\min(R, C)}{\max(R, C)}

    Gavish and Donoho 2017, eq. 7, divided by the singular value. Of a matrix without structure the
    result's divergence is (Candes, Sing-Long and Trzasko 2013, eq. 9)

    .. math::
        \sum_i \Big(\frac{\partial g y}{\partial y_i} + |R - C| g_i\Big)
        + 2 \sum_{i \ne j} \frac{g_i y_i^2}{y_i^2 - y_j^2},

    where constant factors of its rows would have :math:`C \sum_i g_i`.
    """
    columns = columns[:, None].to(power)
    longer, shorter = columns.clamp(min=rows), columns.clamp(max=rows)
    u, ratio = power.clamp(min=0.0) / longer, shorter / longer  # rounding makes some negative
    above = u > (1.0 + ratio.sqrt()).square()
    safe = torch.where(above, u, 1.0)
    root = ((u - ratio - 1.0).square() - 4.0 * ratio).clamp(min=0.0).sqrt()
    gain = torch.where(above, root / safe, 0.0)
    rise = torch.where(above, 2.0 * (u - ratio - 1.0) / root.clamp(min=STEEPEST) - gain, 0.0)
    among = _differences(gain * u, u, shorter)
    free = (rise + (longer - shorter) * gain).sum(1) + among
    constant = (columns * gain).sum(1)
    return gain, torch.where(constant > 0, free / torch.where(constant > 0, constant, 1.0), 1.0)


def _differences(value: Tensor, u: Tensor, shorter: Tensor) -> Tensor:
    """Sums of divided differences over all pairs of the largest ``shorter (N, 1)`` of u, rising."""
    place = torch.arange(u.shape[1], device=u.device)
    real = place >= u.shape[1] - shorter
    apart = u[:, :, None] - u[:, None, :]
    far = apart.abs() > 1e-9 * (1.0 + u[:, :, None])
    pair = real[:, :, None] & real[:, None, :] & far
    rise = (value[:, :, None] - value[:, None, :]) / torch.where(far, apart, 1.0)
    return torch.where(pair, rise, 0.0).sum((1, 2))
