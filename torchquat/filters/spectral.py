"""Empirical-Bayes shrinkage of local spectra."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchquat import noise, so3, timeline
from torchquat._checks import check_count, check_positive
from torchquat.filters._bandwidth import Bandwidth, per_joint
from torchquat.filters._correlation import noise_of, rounded
from torchquat.filters._local_spectra import Windows, correlated_power, shrunk, windows_of
from torchquat.filters._moving_frame import ROUGH_RADIUS, path_of, rough_motion
from torchquat.filters._whitened import along, away_from, main_axes, rows, units_of

__all__ = ["LocalSpectrumFilter", "check_window", "local_spectrum_filter", "noise_level"]


def local_spectrum_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    window: int = 64,
    sigma: Bandwidth | None = None,
) -> Tensor:
    r"""Keep of every window's spectrum what stands out of the noise.

    The rotations become vectors about a smooth motion near them, are divided by the noise of their
    joint, cut into overlapping windows and turned into cosine coefficients. Motion has the spectrum
    of a power law, :math:`s_k = e^a k^{-p}`, of a level and a steepness that every window and axis
    finds for itself: Wiener's gains :math:`s_k / (s_k + 1)` are averaged over all, by how well each
    explains the coefficients. The first pass takes the three axes of a joint alike; the second one
    starts from its result and takes each of the main axes of its movement alone.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame. A frame of half the
            largest weight of its joint counts as one of twice the noise power.
        window: Length of a window [frames], >= 2.
        sigma: Standard deviation of each component of the noise [rad], > 0; one value or one per
            joint; the noise is white then. ``None``: found as by
            :func:`torchquat.noise.estimate_sigma`, and with it the correlation of neighbouring
            frames that the noise of all joints has.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Derivatives take gains, axes and the noise as given:
        they are those of the linear filter that the data have chosen.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.
    """
    check_window(window, 2, sigma)
    prepared, confidence = timeline.prepare(q, weight)
    if q.numel() == 0:
        return prepared.to(q.dtype)
    with torch.autocast(q.device.type, enabled=False):
        motion = rough_motion(prepared.detach(), ROUGH_RADIUS)
        if sigma is None:
            level, rho = noise_of(prepared, motion, confidence)
        else:
            level, rho = noise_level(prepared, confidence, sigma), None
        result = _denoised(prepared, confidence, level, window, rho, motion)
    return timeline.restore(result, prepared, q)


class LocalSpectrumFilter(nn.Module):
    """Module form of :func:`local_spectrum_filter`; arguments as there."""

    sigma: Tensor | None

    def __init__(self, window: int = 64, *, sigma: float | Sequence[float] | None = None) -> None:
        super().__init__()
        check_window(window, 2, sigma)
        self.window = window
        given = None if sigma is None else torch.as_tensor(sigma, dtype=torch.float64)
        self.register_buffer("sigma", given)

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return local_spectrum_filter(q, weight, window=self.window, sigma=self.sigma)

    def extra_repr(self) -> str:
        """Window and noise."""
        return f"window={self.window}, sigma={None if self.sigma is None else self.sigma.tolist()}"


def check_window(window: int, least: int, sigma: Bandwidth | None) -> None:
    """Arguments of a filter with a window, for noise that may be known."""
    check_count("window", window, least)
    if sigma is not None:
        check_positive("sigma", sigma)


def noise_level(q: Tensor, weight: Tensor | None, sigma: Bandwidth | None) -> Tensor:
    """White noise of every joint [rad], given or estimated, ``(..., J)``."""
    if sigma is not None:
        # a number would become float32 on its way: 1e-8 of it lost
        given = torch.as_tensor(
            per_joint("sigma", sigma, q), dtype=q.dtype, device=q.device
        ).detach()
        return given.to(q.dtype).expand(*q.shape[:-3], q.shape[-2])
    return rounded(noise.estimate_sigma(q.detach(), weight))


def _denoised(
    q: Tensor,
    weight: Tensor | None,
    sigma: Tensor,
    window: int,
    rho: Tensor | None,
    motion: Tensor,
) -> Tensor:
    """Both passes, from a smooth motion near; joints without noise stay as they are.

    ``rho`` ``(..., G)`` is the correlation of neighbouring frames of the noise, of each of G equal
    parts of the joints; ``None`` for white noise.
    """
    units = units_of(sigma, weight)
    windows = windows_of(q.shape[-3], window, q)
    power = None
    if rho is not None:
        power = correlated_power(windows.basis, rho.reshape(-1, rho.shape[-1]))
    with torch.no_grad():
        path = path_of(motion) / units.scale
        # no_grad lets forward derivatives pass
        rough = away_from(motion, q.detach(), units)
        move = _over_windows(rough, path, windows, 3, power)
        axes = main_axes(path + move)
        motion = so3.turn(motion, units.scale * move)
        path = path_of(motion) / units.scale
    away = away_from(motion, q, units)
    move = _over_windows(along(away, axes), along(path, axes), windows, 1, power)
    return torch.where(units.noisy, so3.turn(motion, units.scale * along(move, axes.mT)), q)


def _over_windows(
    away: Tensor, path: Tensor, windows: Windows, together: int, power: Tensor | None
) -> Tensor:
    return shrunk(rows(away), rows(path), windows, together, power).reshape(away.shape)
