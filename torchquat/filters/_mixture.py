"""Three estimates of a motion, mixed joint by joint: the shrinkage of the denoiser."""

import torch
from torch import Tensor

from torchquat import so3
from torchquat.filters._hankel import freedom
from torchquat.filters._local_spectra import (
    correlated_power,
    correlations,
    shrunk,
    shrunk_with_freedom,
    windows_of,
)
from torchquat.filters._mixing import Estimate, mixed
from torchquat.filters._moving_frame import path_of
from torchquat.filters._whitened import (
    Stretch,
    along,
    away_from,
    in_radians,
    in_units,
    main_axes,
    rows,
    units_of,
)
from torchquat.filters.low_rank import low_rank_move

__all__ = ["mixture"]

FIRST, HOPS = 64, 2  # windows of the first guess [frames], and how many see a frame
WINDOWS = (40, 192)  # of the local spectra [frames]
STACK, SPAN = 6, 64  # rows of a Hankel matrix and the stretch it is made of [frames]


def mixture(
    q: Tensor,
    weight: Tensor | None,
    sigma: Tensor,
    rho: Tensor,
    motion: Tensor,
    stretch: Stretch | None = None,
) -> Tensor:
    """Shrink low-rank trajectories, and local spectra in short and in long windows about them.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        weight: Confidence ``(..., T, J)``.
        sigma: Noise of every joint ``(..., J)`` [rad]; joints without noise stay as they are.
        rho: Correlation of neighbouring frames of the noise ``(..., 1)``.
        motion: A smooth motion near q ``(..., T, J, 4)``.
        stretch: About which axes the noise is larger.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Derivatives take gains, axes, shares and the noise as
        given.
    """
    units = units_of(sigma, weight, stretch)
    rho = rho.reshape(-1, 1)
    with torch.no_grad():
        path = in_units(path_of(motion), units)
        # no_grad lets forward derivatives pass
        move = _rough(away_from(motion, q.detach(), units), path, rho)
        axes = main_axes(path + move)
        motion = so3.turn(motion, in_radians(move, units))
        path = in_units(path_of(motion), units)
    away = away_from(motion, q, units)
    turned, known = along(away, axes), along(path, axes)
    estimates = [_local(turned, known, window, rho) for window in WINDOWS]
    estimates.append(_low_rank(away, path, units.noisy, rho, axes))
    believed = torch.ones_like(away[..., :1]) if units.trust is None else units.trust
    move = mixed(estimates, turned, torch.where(units.noisy, believed, 0.0)[..., 0])
    move = in_radians(along(move, axes.mT), units)
    return torch.where(units.noisy, so3.turn(motion, move), q)


def _rough(away: Tensor, path: Tensor, rho: Tensor) -> Tensor:
    """A first guess, all axes of a joint alike: good enough to start from."""
    windows = windows_of(away.shape[-3], FIRST, away, hops=HOPS)
    power = correlated_power(windows.basis, rho)
    return shrunk(rows(away), rows(path), windows, 3, power).reshape(away.shape)


def _local(away: Tensor, path: Tensor, window: int, rho: Tensor) -> Estimate:
    """Every axis of every joint alone."""
    windows = windows_of(away.shape[-3], window, away)
    power = correlated_power(windows.basis, rho)
    move, follow = shrunk_with_freedom(rows(away), rows(path), windows, power)
    return Estimate(move.reshape(away.shape), follow.reshape(away.shape[:-1]))


def _low_rank(away: Tensor, path: Tensor, noisy: Tensor, rho: Tensor, axes: Tensor) -> Estimate:
    """All noisy joints together, along the axes of each."""
    move, smoother = low_rank_move(away, path, noisy, STACK, SPAN)
    colour = correlations(rho[:, 0], smoother.frame.shape[1])
    follow = 3.0 * freedom(smoother, rows(away).shape, colour)
    follow = follow.reshape(*away.shape[:-2], 1).expand(away.shape[:-1])
    return Estimate(along(move, axes), follow)
