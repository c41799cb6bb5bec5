"""Shrinkage of local spectra: cosine transforms in overlapping windows, each with its own prior."""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat._eager import visible
from torchquat.filters._overlap import blended, centred, cut, frames_of, larger, smaller

__all__ = [
    "Windows",
    "correlated_power",
    "correlations",
    "power_laws",
    "shrunk",
    "shrunk_with_freedom",
    "times",
    "windows_of",
]

HOPS = 4  # windows over every frame
SLOPES = (2.0, 3.0, 4.0, 5.0, 6.0)  # exponents of the power laws
LEVELS = (-4.0, 20.0, 13)  # logarithms of their power, in units of the noise: from, to, how many
EVEN = 8  # columns at a time
AT_A_TIME = 300_000  # likelihoods, which are the most numbers there are: as the cache holds
CONSTANT = 1e6  # prior power of a window's mean, which noise must not shrink


class Windows(NamedTuple):
    """Where windows lie, how they are weighed, and what is known about what they see."""

    frame: Tensor  # (N, W): the frame of each place
    basis: Tensor  # (W, W): orthonormal cosines, one a row
    taper: Tensor  # (W, 1)
    family: Tensor  # (M, W): prior powers, in units of the noise
    frequency: Tensor  # (W,): half cycles in 64 frames


def windows_of(
    frames: int, window: int, like: Tensor, *, hops: int = HOPS, most: int | None = None
) -> Windows:
    """Windows over a sequence, symmetric in time; one that is too short gets shorter windows.

    Args:
        frames: Length of the sequence, >= 1.
        window: Length of a window, >= 2.
        like: Has the dtype and device that are wanted.
        hops: How many windows see a frame.
        most: How many windows there are at most, even; some frames may be seen by none.
    """
    size = smaller(frames, window)
    hop = max(window // hops, 1)
    beyond = frames - size
    pairs = (beyond + 2 * hop - 1) // (2 * hop) + smaller(beyond, 1)
    if most is not None:
        pairs = smaller(pairs, most // 2)
    count = larger(2 * pairs, 2)  # one alone would be multiplied by another kernel
    frequency = torch.arange(size, device=like.device).to(torch.float64)
    middle = (frequency + 0.5) / size
    basis = torch.cos(math.pi * frequency[:, None] * middle)
    basis = basis / basis.square().sum(-1, keepdim=True).sqrt()
    taper = torch.sin(math.pi * middle)[:, None]
    frequency = frequency * (64.0 / size)
    family = power_laws(frequency, LEVELS, SLOPES)
    basis, taper, family = (x.to(like.dtype) for x in (basis, taper, family))
    frame = frames_of(count, frames, size, like.device)
    return Windows(frame, basis, taper, family, frequency)


def power_laws(
    frequency: Tensor, levels: tuple[float, float, int], slopes: tuple[float, ...]
) -> Tensor:
    """Power laws of half cycles in 64 frames, flat below one half, ``(M, W)``."""
    steepness = torch.tensor(slopes, dtype=torch.float64, device=frequency.device)
    low, high, count = levels
    level = torch.linspace(low, high, count, dtype=torch.float64, device=frequency.device)
    decay = torch.log(frequency.clamp(min=0.5))
    power = torch.exp(level[:, None, None] - steepness[:, None] * decay).flatten(0, 1)
    return torch.where(frequency == 0, CONSTANT, power)


def correlations(rho: Tensor, size: int) -> Tensor:
    """``rho^l`` at lags l from 0 to ``size - 1``, ``(..., size)``; 1 at lag 0."""
    lag = torch.arange(size, device=rho.device)
    return torch.where(lag == 0, 1.0, rho[..., None] ** lag.clamp(min=1))  # no 0^0


def correlated_power(basis: Tensor, rho: Tensor) -> Tensor:
    r"""Power of each coefficient of noise whose frames l apart have the correlation rho^l.

    .. math:: n_k = \sum_{ij} b_{ki} b_{kj} \rho^{|i - j|}

    Args:
        basis: Orthonormal rows ``(W, W)``.
        rho: Correlation of neighbouring frames ``(...)``, in [0, 1).

    Returns:
        Powers ``(..., W)``; all 1, to the last bit, where ``rho`` is 0.
    """
    place = torch.arange(basis.shape[0], device=basis.device)
    apart = (place[:, None] - place).abs()
    decay = torch.where(place == 0, 0.0, correlations(rho, basis.shape[0]))
    return 1.0 + ((decay[..., apart] @ basis.mT) * basis.mT).sum(-2)


def shrunk(
    x: Tensor,
    path: Tensor,
    windows: Windows,
    together: int,
    noise_power: Tensor | None = None,
) -> Tensor:
    r"""Posterior means of a path seen in noise of unit power, white or not.

    In every window the coefficients :math:`y_k` of a channel have one of the prior powers
    :math:`s_{mk}` of the family, all alike before anything is seen:

    .. math::
        \hat y_k = y_k \sum_m p_m \frac{s_{mk}}{s_{mk} + n_k}, \quad
        \log p_m = -\frac12 \sum_k \Big(\log(s_{mk} + n_k) + \frac{y_k^2}{s_{mk} + n_k}\Big) + c

    Args:
        x: How far the data lie from the path ``(N, T, C)``; derivatives follow it alone.
        path: Path ``(N, T, C)``, counted with the data.
        windows: From :func:`windows_of`.
        together: Neighbouring channels that share a prior, a divisor of ``C``.
        noise_power: Power of the noise in every coefficient ``(N, G, W)``, > 0; each of G equal
            parts of the channels has its own, whole priors to a part. ``None``: 1, white noise.

    Returns:
        What to add to the path, ``(N, T, C)``.
    """

    def change(some: Windows) -> list[Tensor]:
        known, coefficients = _coefficients(x, path, some)
        gain = _gains(coefficients.detach(), some.family, together, noise_power)
        return [times(some.basis.mT, gain * coefficients) - known]

    return blended(_in_groups(change, windows, x)[0], windows.taper, windows.frame, x.shape)


def shrunk_with_freedom(
    x: Tensor, path: Tensor, windows: Windows, noise_power: Tensor
) -> tuple[Tensor, Tensor]:
    r"""As :func:`shrunk` of every channel alone, and how far it follows the noise of its own frame.

    The gains :math:`h_{mk} = s_{mk} / (s_{mk} + n_k)` are weighed by what the data say, too:

    .. math::
        n_k \frac{\partial \hat y_k}{\partial y_k} = n_k \sum_m p_m h_{mk} + y_k^2
        \Big(\sum_m p_m h_{mk}^2 - \Big(\sum_m p_m h_{mk}\Big)^2\Big)

    Every frame gets its part by the squares of the cosines; products of two are left out.

    Returns:
        What to add to the path ``(N, T, C)``; freedom ``(N, T, C / 3)``, of three channels a sum.
    """

    def change(some: Windows) -> list[Tensor]:
        known, coefficients = _coefficients(x, path, some)
        power = coefficients.detach().square()
        gain, square = _moments(power, some.family, noise_power)
        noise = noise_power.mT.repeat_interleave(x.shape[-1] // noise_power.shape[1], -1)
        noise = noise.repeat_interleave(some.frame.shape[0], 0)
        follow = noise * gain + power * (square - gain.square()).clamp(min=0.0)
        follow = follow.unflatten(-1, (-1, 3)).sum(-1)
        freedom = times(some.basis.square().mT, follow)
        return [times(some.basis.mT, gain * coefficients) - known, freedom]

    parts = _in_groups(change, windows, x)
    move, freedom = (blended(part, windows.taper, windows.frame, x.shape) for part in parts)
    return move, freedom


def _in_groups(
    change: Callable[[Windows], list[Tensor]], windows: Windows, x: Tensor
) -> list[Tensor]:
    """Some windows at a time, where nothing but speed and memory depends on how many."""
    count = windows.frame.shape[0]
    pairs = max(AT_A_TIME // (2 * x.shape[-1] * len(windows.family)), 1)
    groups = -(-count // (2 * pairs)) if visible(x) else 1
    if groups == 1:
        return change(windows)
    split = [windows._replace(frame=frame) for frame in windows.frame.split(2 * pairs)]
    made = [[part.unflatten(0, (len(x), -1)) for part in change(some)] for some in split]
    return [torch.cat(parts, 1).flatten(0, 1) for parts in zip(*made, strict=True)]


def _coefficients(x: Tensor, path: Tensor, windows: Windows) -> tuple[Tensor, Tensor]:
    """The path in every window about its mean, ``(N, W, C)``, and the coefficients of the data."""
    known = centred(cut(path, windows.frame))
    return known, times(windows.basis, known + cut(x, windows.frame))


def _gains(
    coefficients: Tensor, family: Tensor, together: int, noise_power: Tensor | None
) -> Tensor:
    """Mean Wiener gains ``(N, W, C)`` under the evidence of each window and channel."""
    power = coefficients.square().unflatten(-1, (-1, together)).sum(-1)
    if noise_power is None:
        gain = _mean_gains(power, family + 1.0, family, together)
    else:
        gain = _with_colour(power, family, together, noise_power, squares=False)
    return gain.repeat_interleave(together, -1)


def _moments(power: Tensor, family: Tensor, noise_power: Tensor) -> tuple[Tensor, Tensor]:
    """Means of the gains of each channel, and of their squares."""
    both = _with_colour(power, family, 1, noise_power, squares=True)
    gain, square = both.chunk(2, 1)
    return gain, square


def _with_colour(
    power: Tensor, family: Tensor, together: int, noise_power: Tensor, *, squares: bool
) -> Tensor:
    """Gains under noise of several colours; ``squares`` below them, ``(N, W or 2 W, C)``."""
    if torch.compiler.is_compiling():  # half of the windows may be one, which needs its own graph
        noisy = (family + noise_power.flatten(0, 1)[:, None]).unflatten(0, noise_power.shape[:2])
        return _gains_of_parts(power, noisy, family, together, squares=squares)
    parts, shape = _by_noise(power, noise_power)
    noisy = family + noise_power.flatten(0, 1).repeat_interleave(2, 0)[:, None]
    return _from_parts(_mean_gains(parts, noisy, family, together, squares=squares), shape)


def _mean_gains(
    power: Tensor, noisy: Tensor, family: Tensor, together: int, *, squares: bool = False
) -> Tensor:
    """For powers ``(B, W, C)`` and noisy priors ``(M, W)`` or ``(B, M, W)``."""
    misfit = times(1.0 / noisy, power) + together * torch.log(noisy).sum(-1)[..., None]
    gain = family / noisy
    if squares:
        gain = torch.cat([gain, gain.square()], -1)
    return times(gain.mT, torch.softmax(-0.5 * misfit, -2))


def _gains_of_parts(
    power: Tensor, noisy: Tensor, family: Tensor, together: int, *, squares: bool
) -> Tensor:
    """The same for all powers ``(N windows, W, C)`` and ``(N, G, M, W)``; takes more memory."""
    windows = power.shape[0] // noisy.shape[0]
    parts = zip(power.chunk(noisy.shape[1], -1), noisy.unbind(1), strict=True)
    gains = [
        _mean_gains(x, each.repeat_interleave(windows, 0), family, together, squares=squares)
        for x, each in parts
    ]
    return torch.cat(gains, -1)


def _by_noise(power: Tensor, noise_power: Tensor) -> tuple[Tensor, tuple[int, ...]]:
    """All that sees the same noise as the columns of one matrix, in two halves.

    One matrix alone would be multiplied by another kernel than several are.
    """
    items, groups = noise_power.shape[:2]
    size, channels = power.shape[1:]
    split = power.reshape(items, 2, -1, size, groups, channels // groups)
    moved = split.permute(0, 4, 1, 3, 2, 5)  # item, group, half, W, window, channel
    return moved.reshape(items * groups * 2, size, -1), moved.shape


def _from_parts(gain: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Back to ``(N, W, C)``, or ``(N, 2 W, C)``."""
    moved = gain.reshape(*shape[:3], -1, *shape[4:]).permute(0, 2, 4, 3, 1, 5)
    return moved.reshape(-1, moved.shape[3], shape[1] * shape[5])


def times(matrix: Tensor, x: Tensor) -> Tensor:
    """A matrix ``(M, W)``, or ``(N, M, W)``, times ``(N, W, C)``, to the same bits whatever N is.

    Products of rows that end at odd places in memory would depend on where they lie.
    """
    columns = x.shape[-1]
    even = torch.nn.functional.pad(x, (0, -columns % EVEN))
    return torch.bmm(matrix.expand(x.shape[0], -1, -1), even)[..., :columns]
