"""Low-rank trajectories: what all joints do together over a few frames, told from noise."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchquat import so3, timeline
from torchquat.filters._bandwidth import Bandwidth
from torchquat.filters._hankel import Smoother, smoothed
from torchquat.filters._moving_frame import ROUGH_RADIUS, path_of, rough_motion
from torchquat.filters._whitened import away_from, rows, units_of
from torchquat.filters.spectral import check_window, noise_level

__all__ = ["LowRankFilter", "low_rank_filter", "low_rank_move"]


def low_rank_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    window: int = 8,
    sigma: Bandwidth | None = None,
) -> Tensor:
    r"""Keep what few modes express of the trajectories of all joints.

    The rotations become vectors about a smooth motion near them, are divided by the noise of their
    joint, and :math:`K` consecutive frames of all joints make a row of a Hankel matrix. Its
    singular values are shrunk as is best for white noise, and its anti-diagonals averaged:

    .. math::
        \hat x_a = \frac1{|k|} \sum_k \hat H_{a-k,k}, \quad
        \hat H = \sum_i \eta(y_i) u_i v_i^T, \quad
        \eta(y) = \frac{\sqrt{(y^2 - \beta - 1)^2 - 4 \beta}}{y}

    for :math:`y > 1 + \sqrt\beta` and 0 below, in units of the noise times the root of the longer
    side; :math:`\beta` is the ratio of the sides. Stretches of 128 frames overlap by half and
    more, and are blended. Joints share modes, on purpose. A joint without noise stays as it is,
    and takes no part.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame. What is believed less
            than the largest weight of its joint is moved towards the smooth motion.
        window: Frames in a row of the matrix, >= 1; half the length of a short sequence at most.
        sigma: Standard deviation of each component of the noise [rad], > 0; one value or one per
            joint. ``None``: :func:`torchquat.noise.estimate_sigma`.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Derivatives take modes, gains and the noise as given:
        they are those of the linear filter that the data have chosen, and finite where singular
        values coincide or vanish.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.

    Reference:
        Gavish and Donoho, "Optimal Shrinkage of Singular Values", IEEE Transactions on Information
        Theory 2017, for the Frobenius norm. The noise of a Hankel matrix repeats along its
        anti-diagonals; it is shrunk as if it did not.
    """
    check_window(window, 1, sigma)
    prepared, confidence = timeline.prepare(q, weight)
    if q.numel() == 0:
        return prepared.to(q.dtype)
    level = noise_level(prepared, confidence, sigma)
    with torch.autocast(q.device.type, enabled=False):
        result = _denoised(prepared, confidence, level, window)
    return timeline.restore(result, prepared, q)


class LowRankFilter(nn.Module):
    """Module form of :func:`low_rank_filter`; arguments as there."""

    sigma: Tensor | None

    def __init__(self, window: int = 8, *, sigma: float | Sequence[float] | None = None) -> None:
        super().__init__()
        check_window(window, 1, sigma)
        self.window = window
        given = None if sigma is None else torch.as_tensor(sigma, dtype=torch.float64)
        self.register_buffer("sigma", given)

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return low_rank_filter(q, weight, window=self.window, sigma=self.sigma)

    def extra_repr(self) -> str:
        """Window and noise."""
        return f"window={self.window}, sigma={None if self.sigma is None else self.sigma.tolist()}"


def _denoised(q: Tensor, weight: Tensor | None, sigma: Tensor, window: int) -> Tensor:
    units = units_of(sigma, weight)
    motion = rough_motion(q, ROUGH_RADIUS).detach()
    path = path_of(motion) / units.scale
    move, _ = low_rank_move(away_from(motion, q, units), path, units.noisy, window)
    return torch.where(units.noisy, so3.turn(motion, units.scale * move), q)


def low_rank_move(
    away: Tensor, path: Tensor, noisy: Tensor, window: int, span: int | None = None
) -> tuple[Tensor, Smoother]:
    """What to add to the paths ``(..., T, J, 3)`` of all noisy joints, and by what smoother."""
    seen, known = (rows(torch.where(noisy, v, 0.0)) for v in (away, path))
    channels = 3 * noisy.sum((-3, -2, -1)).clamp(min=1).reshape(-1)
    move, smoother = smoothed(seen, known, window, channels, span)
    return move.reshape(away.shape), smoother
