"""How much white noise there is in a motion that nobody has seen clean."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import missing
from torchquat._checks import check_signal
from torchquat.noise._axes import AXES, least_axes
from torchquat.noise._differences import Differences, differences, overlap
from torchquat.noise._ranks import masked_mean, quantile, running_mean

__all__ = ["Measured", "estimate_sigma", "measured", "sizes_of"]

CUT = 3.5  # standard deviations: longer vectors are something else than noise
KEPT_POWER = 0.9754  # mean of chi_3^2 / 3 where it is below CUT^2
START, START_POWER = 0.3, 1.4237  # a quantile that outliers hardly move, and that of chi_3^2
PASSES = 8
QUIET_POWER = {2: 0.7027, 4: 0.6517, 6: 0.6176, 8: 0.5936}
"""Mean power of white noise in the quieter half of its windows, by order of the difference."""
DOUBT = 2.0  # standard errors by which a less certain estimate must be lower to be believed
LEAST_COUNT = 4.0  # independent vectors that an estimate must rest on
LARGEST = 1.3  # [rad]; beyond it rotations lie so evenly that nothing tells sizes apart


class Estimate(NamedTuple):
    """Mean squared difference per axis ``(..., J)``, its relative standard error, and if any."""

    order: int
    power: Tensor
    error: Tensor
    known: Tensor


class Measured(NamedTuple):
    """Differences, and estimates of the noise by them as if it were alike about all axes."""

    found: list[Differences]
    estimates: list[Estimate]


def estimate_sigma(q: Tensor, weight: Tensor | None = None) -> Tensor:
    r"""Standard deviation of the white noise of every joint, as :func:`gaussian` makes it.

    The p-th difference of the rotation matrices removes motion that is a polynomial of time within
    p + 1 frames. Of independent noise it leaves, whatever its size,

    .. math::
        E \Big\| \sum_k (-1)^k \binom{p}{k} R_{t+k} \Big\|^2 = 3 \binom{2p}{p} (1 - \lambda^2),
        \quad \lambda = \frac{1 + 2 (1 - \sigma^2) e^{-\sigma^2 / 2}}{3}

    which is solved for :math:`\sigma`. The mean runs over vectors below 3.5 standard deviations
    and is corrected for that: single outliers and both ends of a pop do not count. What motion is
    left is sought out in three ways, each with its standard error: by orders p = 2, 4, 6, 8; by the
    quieter half of the windows of 9 frames; by the least one or two eigenvalues of the covariance
    of the three axes, as joints hardly ever move about all of them alike, and noise is taken to.
    The lowest estimate wins whose lead is more than chance.

    Noise that lasts for several frames is underestimated: most of it looks like motion. Motion that
    frames are too far apart for is taken as noise: about 0.001 rad at 30 frames a second, and
    several times that in dance.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm and sign.
        weight: Confidence or mask, broadcastable to ``(..., T, J)``. Frames that are missing do not
            count; other weights make no difference.

    Returns:
        Standard deviation of each component of the noise's rotation vector [rad], ``(..., J)``, in
        the dtype of ``q``, at most 1.3. 0 where fewer than ten frames are present. It has no
        gradient. The standard error is 4 % for 300 frames, 5 % for 200 and 2 % for 1000 and more:
        of long sequences, 1024 frames are looked at.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or device does not fit.

    Reference:
        Hall, Kay and Titterington, "Asymptotically optimal difference-based estimation of variance
        in nonparametric regression", Biometrika 1990, for differences in general.
    """
    return sizes_of(measured(q, weight).estimates, (0.0,))[0].to(q.dtype)


def measured(q: Tensor, weight: Tensor | None) -> Measured:
    """What the size of the noise is told from, the same for all correlations.

    Long sequences are seen in 16 windows, spread evenly over what is present of each joint.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm and sign.
        weight: Confidence or mask, broadcastable to ``(..., T, J)``.
    """
    check_signal(q, weight)
    with torch.no_grad():
        found = list(differences(q.detach(), missing.validity(q.detach(), weight)))
        estimates = [estimate for each in found for estimate in _estimates(each)]
        return Measured(found, estimates)


def sizes_of(estimates: list[Estimate], rhos: Sequence[float]) -> Tensor:
    r"""As :func:`estimate_sigma`, for noise as :func:`correlated` makes it.

    Differences see less of such noise: their power is that of white noise times
    :math:`\sum_l (-1)^l \binom{2p}{p + l} \rho^{|l|} / \binom{2p}{p}`.

    Args:
        estimates: Of :func:`measured`.
        rhos: Correlations of neighbouring frames that may be the true one, in [0, 1).

    Returns:
        Standard deviations for each of them, ``(R, ..., J)``.
    """
    with torch.no_grad():
        power = _lowest(
            each._replace(power=each.power / _seen(each.order, rhos, each.power))
            for each in estimates
        )
        return _size(power)


def _seen(order: int, rhos: Sequence[float], like: Tensor) -> Tensor:
    """Share of correlated noise that differences of an order see, ``(R, 1, ..., 1)``."""
    full = math.comb(2 * order, order)
    lags = {lag: 2.0 * math.comb(2 * order, order + lag) / full for lag in range(1, order + 1)}
    shares = [1.0 + sum(part * (-rho) ** lag for lag, part in lags.items()) for rho in rhos]
    return torch.tensor(shares, dtype=like.dtype, device=like.device).reshape(
        -1, *(1,) * like.dim()
    )


def _estimates(found: Differences) -> Iterator[Estimate]:
    """From all and from quiet times, by three, two and one axis."""
    square, valid, vector = (x.flatten(-2) for x in (found.square, found.valid, found.vector))
    variance = _truncated(square, valid)
    inside = valid & (square < CUT**2 * variance)
    local = running_mean(found.square, inside.reshape(found.valid.shape)).flatten(-2)
    quiet = inside & (local <= quantile(local, inside, 0.5))
    calm = masked_mean(square, quiet) / (AXES * QUIET_POWER[found.order])
    for chosen, power in ((inside, variance), (quiet, calm)):
        independent = chosen.sum(-1).to(power.dtype) / overlap(found.order)
        enough = independent >= LEAST_COUNT
        axes = least_axes(vector, chosen, independent.clamp(min=LEAST_COUNT))
        for ratio, error, known in axes:
            yield Estimate(found.order, power.squeeze(-1) * ratio, error, known & enough)


def _truncated(square: Tensor, valid: Tensor) -> Tensor:
    """Mean square per axis ``(..., J, 1)`` of those below the cut, as if none were above it."""
    variance = quantile(square, valid, START) / START_POWER
    for _ in range(PASSES):
        inside = valid & (square < CUT**2 * variance)
        variance = masked_mean(square, inside) / (AXES * KEPT_POWER)
    return variance


def _lowest(estimates: Iterator[Estimate]) -> Tensor:
    """The lowest power, if it is lower than the surest one by more than the errors explain.

    The surest estimate comes first. The difference of two has the variance of the unsure one minus
    that of the sure one (Hausman 1978).
    """
    surest = next(estimates)
    best = bound = surest.power
    for _, power, error, known in estimates:
        apart = (error.square() - surest.error.square()).clamp(min=0.0).sqrt()
        own = power * (1.0 + DOUBT * apart).square()
        lower = known & (own < bound)
        best, bound = torch.where(lower, power, best), torch.where(lower, own, bound)
    return torch.where(surest.known, best, 0.0)


def _size(power: Tensor) -> Tensor:
    r"""Solve :math:`(1 - \lambda^2) / 2 = x` for :math:`\sigma`, by Newton's method.

    The left side is concave in the variance, so that it is approached from below.
    """
    most = _bend(torch.tensor(LARGEST**2, dtype=torch.float64, device="cpu"))[0]
    wanted = power.clamp(max=float(most))
    variance = wanted
    for _ in range(12):
        value, slope = _bend(variance)
        variance = variance + (wanted - value) / slope
    return variance.clamp(min=0.0).sqrt()


def _bend(variance: Tensor) -> tuple[Tensor, Tensor]:
    """Half of ``1 - lambda^2``, and its slope."""
    decay = torch.exp(-0.5 * variance)
    mean = (1.0 + 2.0 * (1.0 - variance) * decay) / 3.0
    return 0.5 * (1.0 - mean.square()), mean * decay * (3.0 - variance) / 3.0
