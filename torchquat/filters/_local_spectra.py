"""Shrinkage of local spectra: cosine transforms in overlapping windows, each with its own prior."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["Windows", "shrunk", "window_starts", "windows_of"]

HOPS = 8  # windows over every frame
SLOPES = (2.0, 3.0, 4.0, 5.0, 6.0)  # exponents of the power laws
LEVELS = (-4.0, 20.0, 25)  # logarithms of their power, in units of the noise: from, to, how many
EVEN = 8  # columns at a time
CONSTANT = 1e6  # prior power of a window's mean, which noise must not shrink


class Windows(NamedTuple):
    """Where windows lie, how they are weighed, and what is known about what they see."""

    frame: Tensor  # (N, W): the frame of each place
    basis: Tensor  # (W, W): orthonormal cosines, one a row
    taper: Tensor  # (W, 1)
    family: Tensor  # (M, W): prior powers, in units of the noise


def windows_of(frames: int, window: int, like: Tensor) -> Windows:
    """Windows over a sequence, symmetric in time; one that is too short gets shorter windows."""
    size = torch.sym_min(frames, window)
    start = window_starts(frames, window, HOPS, like.device)
    place = torch.arange(size, device=like.device)
    frequency = place.to(torch.float64)
    middle = (frequency + 0.5) / size
    basis = torch.cos(math.pi * frequency[:, None] * middle)
    basis = basis / basis.square().sum(-1, keepdim=True).sqrt()
    taper = torch.sin(math.pi * middle)[:, None]
    family = _family(frequency * (64.0 / size))
    basis, taper, family = (x.to(like.dtype) for x in (basis, taper, family))
    return Windows(start[:, None] + place, basis, taper, family)


def window_starts(frames: int, window: int, hops: int, device: torch.device) -> Tensor:
    """First frames ``(N,)`` of windows, ``hops`` or more over every frame, symmetric in time."""
    hop = max(window // hops, 1)
    beyond = frames - torch.sym_min(frames, window)
    pairs = (beyond + 2 * hop - 1) // (2 * hop) + torch.sym_min(beyond, 1)
    count = torch.sym_max(2 * pairs, 2)  # one alone would be multiplied by another kernel
    index = torch.arange(count, device=device)
    ahead = index * beyond // (count - 1)
    back = beyond - (count - 1 - index) * beyond // (count - 1)
    return torch.where(2 * index < count, ahead, back)


def _family(frequency: Tensor) -> Tensor:
    """Power laws of half cycles in 64 frames, flat below one half."""
    steepness = torch.tensor(SLOPES, dtype=torch.float64, device=frequency.device)
    low, high, count = LEVELS
    level = torch.linspace(low, high, count, dtype=torch.float64, device=frequency.device)
    decay = torch.log(frequency.clamp(min=0.5))
    power = torch.exp(level[:, None, None] - steepness[:, None] * decay).flatten(0, 1)
    return torch.where(frequency == 0, CONSTANT, power)


def shrunk(x: Tensor, path: Tensor, windows: Windows, together: int) -> Tensor:
    r"""Posterior means of a path seen in white noise of unit power.

    In every window the coefficients :math:`y_k` of a channel have one of the prior powers
    :math:`s_{mk}` of the family, all alike before anything is seen:

    .. math::
        \hat y_k = y_k \sum_m p_m \frac{s_{mk}}{s_{mk} + 1}, \quad
        \log p_m = -\frac12 \sum_k \Big(\log(s_{mk} + 1) + \frac{y_k^2}{s_{mk} + 1}\Big) + c

    Args:
        x: How far the data lie from the path ``(N, T, C)``; derivatives follow it alone.
        path: Path ``(N, T, C)``, counted with the data.
        windows: From :func:`windows_of`.
        together: Neighbouring channels that share a prior, a divisor of ``C``.

    Returns:
        What to add to the path, ``(N, T, C)``.
    """
    batch, frames, channels = x.shape
    places = windows.frame.flatten()
    size = windows.basis.shape[0]
    known = path.index_select(1, places).reshape(-1, size, channels)
    known = known - known.mean(1, keepdim=True)
    seen = x.index_select(1, places).reshape(-1, size, channels)
    coefficients = _times(windows.basis, known + seen)
    gain = _gains(coefficients.detach(), windows.family, together)
    change = _times(windows.basis.mT, gain * coefficients) - known
    ahead = (windows.taper * change).reshape(batch, -1, channels)
    weight = windows.taper.expand(windows.frame.shape[0], -1, -1).reshape(-1, 1)
    total = torch.zeros_like(x).index_add(1, places, ahead)
    return total / weight.new_zeros(frames, 1).index_add(0, places, weight)


def _gains(coefficients: Tensor, family: Tensor, together: int) -> Tensor:
    """Mean Wiener gains ``(N, W, C)`` under the evidence of each window and channel."""
    noisy = family + 1.0
    power = coefficients.square().unflatten(-1, (-1, together)).sum(-1)
    misfit = _times(1.0 / noisy, power) + together * torch.log(noisy).sum(-1)[:, None]
    gain = _times((family / noisy).mT, torch.softmax(-0.5 * misfit, 1))
    return gain.repeat_interleave(together, -1)


def _times(matrix: Tensor, x: Tensor) -> Tensor:
    """One matrix ``(M, W)`` times each of ``(N, W, C)``, to the same bits whatever N is.

    Products of rows that end at odd places in memory would depend on where they lie.
    """
    columns = x.shape[-1]
    even = torch.nn.functional.pad(x, (0, -columns % EVEN))
    return torch.bmm(matrix.expand(x.shape[0], -1, -1), even)[..., :columns]
