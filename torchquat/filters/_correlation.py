"""Noise that lasts: how strongly its frames hang together, found together with its size."""

import torch
from torch import Tensor

from torchquat import so3
from torchquat.filters._local_spectra import (
    Windows,
    correlated_power,
    power_laws,
    times,
    windows_of,
)
from torchquat.filters._moving_frame import path_of
from torchquat.filters._overlap import centred, cut
from torchquat.filters._whitened import Stretch, Units, in_units, rows, units_of
from torchquat.noise.estimate import Measured, measured, sizes_of

__all__ = ["noise_of", "rounded"]

RHOS = (0.0, 0.35, 0.5, 0.65, 0.75, 0.83, 0.89, 0.93, 0.96)
"""Correlations to choose from. Less than the second is as good as white."""
MARGIN = 40.0  # natural logarithm of the odds that a stronger correlation must have
WINDOW = 64  # [frames]
MOST = 64  # windows: more would tell nothing new
LEVELS = (-4.0, 32.0, 37)  # reaching up to motions with hardly any noise
SLOPES = (2.0, 3.5, 5.0)
ALONE, BANDS = 10, 26  # the lowest frequencies, each by itself; and all bands
NOTHING = -60.0  # logarithm of odds that do not count
LEAST_PRESENT = 0.5  # of a window, to count
STEP = 2.0**-8  # of the digits of estimated noise, 1/2 to 1


def noise_of(
    q: Tensor,
    motion: Tensor,
    weight: Tensor | None,
    seen: Measured | None = None,
    stretch: Stretch | None = None,
) -> tuple[Tensor, Tensor]:
    r"""Size of the noise of every joint, and the correlation of neighbouring frames of it.

    For each correlation that is tried, the size follows from high differences, which see hardly
    anything but noise. What tells the correlations apart is how well they explain spectra of
    windows down to low frequencies, where any power law may lie on top of the noise. Correlated
    noise and motion look alike in one window, but noise is alike in all windows and on all axes:

    .. math::
        \log p(\rho) = \sum_{wjc} \log \sum_m \prod_k
            N\big(y_{wjck}; 0, s_{mk} + \sigma_j(\rho)^2 n_k(\rho)\big)

    The weakest correlation is taken that is not ruled out, for all joints the same.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``, missing frames filled.
        motion: A smooth motion near it.
        weight: Confidence ``(..., T, J)``.
        seen: What is measured of the noise, if that is known already.
        stretch: About which axes it is larger.

    Returns:
        Standard deviations ``(..., J)`` [rad], rounded, and the correlation ``(..., 1)``.
    """
    with torch.no_grad():
        q = q.detach()
        seen = measured(q, weight) if seen is None else seen
        sigma = sizes_of(seen.estimates, RHOS)
        evidence = _evidence(q, motion.detach(), weight, sigma, stretch)
        chosen = (evidence >= evidence.amax(0) - MARGIN).to(torch.uint8).argmax(0)
        rho = _rhos(q).index_select(0, chosen.flatten()).reshape(*chosen.shape, 1)
        index = chosen[None, ..., None].expand(1, *sigma.shape[1:])
        return rounded(sigma.gather(0, index)[0]), rho


def _rhos(like: Tensor) -> Tensor:
    """In double precision first: compilers round bare numbers to single."""
    return torch.tensor(RHOS, dtype=torch.float64, device=like.device).to(like.dtype)


def rounded(sigma: Tensor) -> Tensor:
    """To a few digits: the last ones of an estimate depend on what else is in the batch."""
    digits, exponent = torch.frexp(sigma)
    # older releases of torch give the power of two in the default dtype
    return torch.ldexp((digits / STEP).round() * STEP, exponent).to(sigma.dtype)


def _evidence(
    q: Tensor, motion: Tensor, weight: Tensor | None, sigma: Tensor, stretch: Stretch | None
) -> Tensor:
    """Logarithm of the likelihood of every correlation, up to a constant, ``(R, ...)``."""
    windows = windows_of(q.shape[-3], WINDOW, q, hops=1, most=MOST)
    known = (sigma > 0).all(0)
    units = units_of(torch.where(known, sigma[0], 0.0), None, stretch)
    sigma = torch.where(known, sigma, 1.0).reshape(len(RHOS), -1, q.shape[-2])
    power, counts = _spectra(q, motion, weight, windows, units)
    counts = counts & known.reshape(-1, 1, q.shape[-2])
    bands = _bands(windows)
    power = times(bands, power)
    family = power_laws(windows.frequency, LEVELS, SLOPES).to(q.dtype)
    colours = correlated_power(windows.basis, _rhos(q))
    total = []
    for colour, size in zip(colours, (sigma / sigma[0]).repeat_interleave(3, -1), strict=True):
        noisy = torch.where(windows.frequency == 0, 1.0, family + colour)
        each = _likelihood(power, noisy, bands, size)
        each = each.unflatten(0, (-1, counts.shape[1])).unflatten(-1, (-1, 3)).sum(-1)
        total.append(torch.where(counts, each, 0.0).sum((1, 2)))
    return torch.stack(total).reshape(len(RHOS), *q.shape[:-3])


def _spectra(
    q: Tensor, motion: Tensor, weight: Tensor | None, windows: Windows, units: Units
) -> tuple[Tensor, Tensor]:
    """Squared coefficients ``(N windows, W, 3 J)``, in units of the noise, and which count.

    Frames that are missing lie on the rough motion, without noise: the rest is scaled up for them.
    """
    present = torch.ones_like(q[..., 0]) if weight is None else (weight > 0).to(q.dtype)
    x = path_of(motion) + present[..., None] * so3.between(motion, q)
    x = rows(in_units(x, units))
    power = times(windows.basis, centred(cut(x, windows.frame))).square()
    share = present.reshape(-1, *present.shape[-2:]).index_select(1, windows.frame.flatten())
    share = share.unflatten(1, windows.frame.shape).mean(2)  # (N, windows, J)
    scale = share.clamp(min=LEAST_PRESENT).flatten(0, 1).repeat_interleave(3, -1)
    return power / scale[:, None], share > LEAST_PRESENT


def _bands(windows: Windows) -> Tensor:
    """Which coefficients are taken together, booleans as numbers ``(BANDS, W)``.

    The lowest alone, the others a sixth of an octave wide; the mean of a window tells nothing.
    """
    k = torch.arange(windows.basis.shape[0], device=windows.basis.device).double()
    above = ALONE + (6.0 * torch.log2(k.clamp(min=1.0) / (ALONE + 1))).floor()
    band = torch.where(k > ALONE, above, k - 1)
    return (band == torch.arange(BANDS, device=band.device)[:, None]).to(windows.basis.dtype)


def _likelihood(power: Tensor, noisy: Tensor, bands: Tensor, size: Tensor) -> Tensor:
    """Of powers with noise ``(M, W)``, in units of ``size (N, C)``: ``(N windows, C)``.

    All are alike before anything is seen. The first coefficient does not count.
    """
    mean = bands / bands.sum(-1, keepdim=True).clamp(min=1.0)
    scaled = power.unflatten(0, (size.shape[0], -1)) / size[:, None, None].square()
    misfit = times((1.0 / noisy) @ (-0.5 * mean.mT), scaled.flatten(0, 1))
    misfit = misfit - 0.5 * torch.log(noisy).sum(-1)[:, None]
    each = _log_total(misfit).unflatten(0, (size.shape[0], -1))
    degrees = noisy.shape[1] - 1
    return (each - degrees * torch.log(size)[:, None]).flatten(0, 1)


def _log_total(x: Tensor) -> Tensor:
    """As logsumexp over axis 1; exponentials that underflow would take thirty times as long."""
    largest = x.amax(1, keepdim=True)
    total = (x - largest).clamp(min=NOTHING).exp().sum(1)
    return largest[:, 0] + total.log()
