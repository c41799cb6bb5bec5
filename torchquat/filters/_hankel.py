"""Optimal shrinkage of the singular values of Hankel matrices, in overlapping windows of time."""

import math

import torch
from torch import Tensor

from torchquat._eager import visible

__all__ = ["SPAN", "shrunk_trajectories"]

SPAN = 128  # longest stretch of time in one matrix [frames]
AT_A_TIME = 8  # stretches, to bound memory


def shrunk_trajectories(x: Tensor, path: Tensor, stack: int, channels: Tensor) -> Tensor:
    """Trajectories seen in white noise of unit power, brought near to what few modes can express.

    Args:
        x: How far the data lie from the path ``(N, T, C)``; derivatives follow it alone.
        path: Path ``(N, T, C)``, counted with the data.
        stack: Consecutive frames in a row of the Hankel matrix.
        channels: How many of the C channels are more than zeros, ``(N,)``.

    Returns:
        What to add to the path, ``(N, T, C)``.
    """
    batch, frames, width = x.shape
    size = _smaller(frames, SPAN)
    start = _starts(frames, SPAN, x.device)
    places = (start[:, None] + torch.arange(size, device=x.device)).flatten()
    known, seen = (y.index_select(1, places).reshape(-1, size, width) for y in (path, x))
    known = known - known.mean(1, keepdim=True)
    count = channels[:, None].expand(-1, start.shape[0]).flatten()
    change = _in_parts(known, seen, count, stack)
    middle = (torch.arange(size, device=x.device, dtype=torch.float64) + 0.5) / size
    taper = torch.sin(math.pi * middle).square().to(x.dtype)[:, None]
    weight = taper.expand(start.shape[0], -1, -1).reshape(-1, 1)
    total = torch.zeros_like(x).index_add(1, places, (taper * change).reshape(batch, -1, width))
    return total / weight.new_zeros(frames, 1).index_add(0, places, weight)


def _smaller(a: int, b: int) -> int:
    """The smaller length, of an open one too."""
    return torch.sym_min(a, b)  # pyright: ignore[reportReturnType]


def _starts(frames: int, span: int, device: torch.device) -> Tensor:
    """First frames ``(N,)`` of stretches that overlap by half or more, symmetric in time."""
    hop = span // 2
    beyond = frames - _smaller(frames, span)
    count = 2 * ((beyond + 3 * hop - 1) // (2 * hop))  # one alone would have another kernel
    index = torch.arange(count, device=device)
    ahead = index * beyond // (count - 1)
    back = beyond - (count - 1 - index) * beyond // (count - 1)
    return torch.where(2 * index < count, ahead, back)


def _in_parts(known: Tensor, seen: Tensor, count: Tensor, stack: int) -> Tensor:
    """A few stretches at a time, where nothing but memory depends on how many."""
    parts = known.shape[0] // AT_A_TIME if visible(known) else 1
    split = [y.tensor_split(max(parts, 1)) for y in (known, seen, count)]
    changes = [_change(*part, stack=stack) for part in zip(*split, strict=True)]
    return changes[0] if len(changes) == 1 else torch.cat(changes)


def _change(known: Tensor, seen: Tensor, count: Tensor, *, stack: int) -> Tensor:
    """What shrinkage adds to known trajectories ``(N, S, C)`` whose centres are 0."""
    middle = seen.mean(1, keepdim=True)
    data = known + (seen - middle)
    smoother = _smoother(data.detach().double(), count, stack).to(data.dtype)
    return torch.bmm(smoother, data) + middle - known


def _smoother(data: Tensor, count: Tensor, stack: int) -> Tensor:
    r"""Matrix ``(N, S, S)`` that shrinks the Hankel matrix of data and averages its diagonals back.

    With :math:`X_k` the rows k to k + R - 1 of the data, the Hankel matrix is
    :math:`H = (X_0, \ldots, X_{K-1})`, and shrinkage multiplies it by the gains :math:`g` of the
    squared singular values, :math:`P = g(H H^T) = g(\sum_k X_k X_k^T)`. Row a of the result is
    the mean of rows a - k of :math:`P X_k`: a sum over the diagonals of P.
    """
    size = data.shape[1]
    lags = _smaller((size + 1) // 2, stack)  # short stretches: about as many rows as lags
    place = torch.arange(size, device=data.device)
    inside = (place <= size - lags).to(data)
    rows = (inside[:, None] * inside) * _along_diagonals(data @ data.mT, lags, stack, 1)
    power, modes = torch.linalg.eigh(rows)
    gain = _gains(power, size - lags + 1, lags * count)
    kept = (modes * gain[:, None, :]) @ modes.mT
    kept = (inside[:, None] * inside) * kept
    rows_over = torch.minimum(place + 1, size - place).clamp(max=_smaller(lags, size - lags + 1))
    return _along_diagonals(kept, lags, stack, -1) / rows_over[:, None]


def _along_diagonals(matrix: Tensor, lags: int, stack: int, side: int) -> Tensor:
    """Sums of ``matrix[a + side k, b + side k]`` over the lags, of what lies inside."""
    size = matrix.shape[1]
    place = torch.arange(size, device=matrix.device)
    total = matrix
    for lag in range(1, stack):
        wanted = place + side * lag
        inside = ((wanted >= 0) & (wanted < size) & (lag < lags)).to(matrix)
        index = wanted.clamp(0, size - 1)
        shifted = matrix.index_select(1, index).index_select(2, index)
        total = total + (inside[:, None] * inside) * shifted
    return total


def _gains(power: Tensor, rows: int, columns: Tensor) -> Tensor:
    r"""Factors of singular values, from their squares ``(N, S)`` in units of the noise.

    .. math::
        g = \frac{\sqrt{(u - \beta - 1)^2 - 4 \beta}}{u}, \quad u > (1 + \sqrt\beta)^2, \quad
        u = \frac{\text{power}}{\max(R, C)}, \quad \beta = \frac{\min(R, C)}{\max(R, C)}

    Gavish and Donoho 2017, eq. 7, divided by the singular value.
    """
    columns = columns[:, None].to(power)
    longer, shorter = columns.clamp(min=rows), columns.clamp(max=rows)
    u, ratio = power / longer, shorter / longer
    above = u > (1.0 + ratio.sqrt()).square()
    beyond = ((u - ratio - 1.0).square() - 4.0 * ratio).clamp(min=0.0)
    return torch.where(above, beyond.sqrt() / torch.where(above, u, 1.0), 0.0)
