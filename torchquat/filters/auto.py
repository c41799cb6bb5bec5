"""The one call for people who want no parameters."""

import math

import torch
from torch import Tensor, nn

from torchquat import so3, timeline
from torchquat.filters._correlation import noise_of, rounded
from torchquat.filters._mixture import mixture
from torchquat.filters._moving_frame import ROUGH_RADIUS, rough_motion
from torchquat.filters._whitened import Stretch, mean_size, stretch_of
from torchquat.filters.repair import mended
from torchquat.noise._principal import principal
from torchquat.noise.estimate import Measured, measured, sizes_of

__all__ = ["AutoDenoiser", "denoise"]


def denoise(q: Tensor, weight: Tensor | None = None, *, strength: float = 1.0) -> Tensor:
    """Remove the noise of a motion, whatever there is, and leave what is clean.

    Displaced stretches are moved back and wild samples replaced, as by :func:`torchquat.repair`.
    The noise of every joint is estimated from the motion itself, and so is how long it lasts, which
    all joints have in common. It is removed by local spectra in short and in long windows, as by
    :func:`torchquat.local_spectrum_filter`, and by the low-rank trajectories of all joints, as by
    :func:`torchquat.low_rank_filter`; each joint mixes the three so that Stein's unbiased estimate
    of the risk is least.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        strength: How far to go from the input to the result along the geodesic between them, in
            [0, 1]; 0 gives the input back bit for bit.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Derivatives take what was estimated as given.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.

    Reference:
        Stein, "Estimation of the Mean of a Multivariate Normal Distribution", Annals of Statistics
        1981, for the risk.
    """
    _check_strength(strength)
    prepared, confidence = timeline.prepare(q, weight)
    if q.numel() == 0 or strength == 0:
        return q.clone()
    with torch.autocast(q.device.type, enabled=False):
        seen = measured(prepared, confidence)
        level, stretch = _noise(seen)
        size = mean_size(level, stretch)[..., None, :]
        repaired, trust = mended(prepared, confidence, size)
        if repaired is not prepared:
            seen = measured(repaired, trust)
            stretch = _noise(seen)[1]
        # what was replaced tells nothing of the noise, but is the best guess at the motion
        motion = rough_motion(repaired.detach(), ROUGH_RADIUS)
        level, rho = noise_of(repaired, motion, trust, seen, stretch)
        result = mixture(repaired, confidence, level, rho, motion, stretch)
        if strength != 1:
            result = so3.slerp(prepared, result, strength)
    return timeline.restore(result, prepared, q)


def _noise(seen: Measured) -> tuple[Tensor, Stretch | None]:
    """Size of the noise of every joint ``(..., J)``, and about which axes it is larger."""
    level = rounded(sizes_of(seen.estimates, (0.0,))[0])
    return level, stretch_of(principal(seen.found), level)


class AutoDenoiser(nn.Module):
    """Module form of :func:`denoise`; arguments as there."""

    def __init__(self, strength: float = 1.0) -> None:
        super().__init__()
        _check_strength(strength)
        self.strength = strength

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Denoise unit quaternions ``(..., T, J, 4)``."""
        return denoise(q, weight, strength=self.strength)

    def extra_repr(self) -> str:
        """How much is done."""
        return f"strength={self.strength}"


def _check_strength(strength: float) -> None:
    if isinstance(strength, bool) or not isinstance(strength, (int, float)):
        raise TypeError(f"strength must be a number, got {strength!r}.")
    if not (math.isfinite(strength) and 0 <= strength <= 1):
        raise ValueError(f"strength must lie in [0, 1], got {strength!r}.")
