"""Which filters can be fed frame by frame, and how."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from torchquat import filters
from torchquat._online.cascade import Windowed
from torchquat._online.patches import nonlocal_means
from torchquat._online.recursions import OneEuro, Tracker
from torchquat._online.windows import Centre, bilateral, hampel, masked, median
from torchquat.filters._bandwidth import per_joint
from torchquat.filters._masks import as_mask
from torchquat.filters._patches import Patches, members
from torchquat.filters.moving_mean import KERNEL
from torchquat.filters.tracking import noise_ratio

__all__ = ["Recursive", "plan"]


@dataclass(frozen=True)
class Recursive:
    """A filter that carries an estimate.

    Attributes:
        machine: The recursion, given a tensor of the dtype and device, ``(..., J, 4)``.
    """

    machine: Callable[[Tensor], OneEuro | Tracker]
    latency: int = 0
    width: int = 1


def plan(filter: nn.Module) -> Windowed | Recursive:
    """How a filter is fed frame by frame.

    Raises:
        TypeError: If it is no filter, or none that can be.
        ValueError: If one of its settings needs the end of the sequence.
    """
    make = _PLANS.get(type(filter))
    if make is None:
        known = ", ".join(kind.__name__ for kind in _PLANS)
        why = _NEED.get(type(filter), "whose window is not known")
        raise TypeError(
            f"filter must see a window or the past only, as {known} do, "
            f"got {type(filter).__name__}, {why}."
        )
    if getattr(filter, "boundary", None) == "circular" and not getattr(filter, "causal", False):
        raise ValueError(
            "boundary must be known before the sequence ends: truncate, replicate, reflect or "
            "extrapolate, got 'circular'."
        )
    return make(filter)


def _of_mask(
    filter: Any, mask: Callable[[Tensor], Tensor], radius: int, *, causal: bool = False
) -> Windowed:
    """A filter that convolves with a mask ``(2k + 1, J or 1)``, which it gives for a tensor."""

    def centre(like: Tensor) -> Centre:
        half = mask(like)[: radius + 1] if causal else mask(like)
        return masked(half / half.sum(0), radius)

    return Windowed(radius, 0 if causal else radius, centre, filter, causal)


def _gaussian(filter: filters.GaussianFilter) -> Windowed:
    def mask(like: Tensor) -> Tensor:
        lag = torch.arange(-filter.radius, filter.radius + 1, dtype=like.dtype, device=like.device)
        sigma_t = per_joint("sigma_t", filter.sigma_t, like)
        return torch.exp(-0.5 * (lag[:, None] / sigma_t).square())

    return _of_mask(filter, mask, filter.radius, causal=filter.causal)


def _linear(filter: filters.LinearFilter) -> Windowed:
    radius = len(filter.mask) // 2
    return _of_mask(filter, partial(as_mask, filter.mask), radius, causal=filter.causal)


def _butterworth(filter: filters.ButterworthFilter) -> Windowed:
    return _of_mask(filter, partial(as_mask, filter.mask), filter.radius)


def _moving_mean(filter: filters.MovingMeanFilter) -> Windowed:
    return _of_mask(filter, partial(as_mask, KERNEL), len(KERNEL) // 2)


def _savitzky_golay(filter: filters.SavitzkyGolayFilter) -> Windowed:
    made = _of_mask(filter, partial(as_mask, filter.mask), filter.radius)
    if filter.boundary != "interp":
        return made
    # the fit to the first whole window is not there yet
    held = filters.SavitzkyGolayFilter(filter.radius, filter.order, boundary="replicate")
    return replace(made, start=held)


def _bilateral(filter: filters.BilateralFilter) -> Windowed:
    # no pass at all fills what is missing, too: as one that sees nothing but its own frame
    past = filter.radius if filter.iterations else 0
    future = 0 if filter.causal else past

    def centre(like: Tensor) -> Centre:
        sigma_t = per_joint("sigma_t", filter.sigma_t, like)
        sigma_g = per_joint("sigma_g", filter.sigma_g, like)
        return bilateral(past, future, sigma_t, sigma_g, filter.kernel == "gaussian", like)

    return Windowed(past, future, centre, filter, filter.causal, max(filter.iterations, 1))


def _nonlocal(filter: filters.NonLocalPoseMeans) -> Windowed:
    if filter.embedding is not None:
        raise ValueError(
            "embedding must be None in a stream: it may read every patch, "
            f"got {type(filter.embedding).__name__}."
        )
    reach = filter.patch_radius + filter.search_radius

    def centre(like: Tensor) -> Centre:
        groups = members(filter.groups, like.shape[-2])
        patches = Patches(groups, filter.patch_radius, filter.search_radius, filter.causal)
        return nonlocal_means(patches, per_joint("sigma", filter.sigma, like), filter.chart, like)

    return Windowed(reach, 0 if filter.causal else reach, centre, filter, filter.causal)


def _median(filter: filters.MedianFilter) -> Windowed:
    def centre(like: Tensor) -> Centre:
        return median(filter.radius, filter.iterations)

    return Windowed(filter.radius, filter.radius, centre, filter)


def _hampel(filter: filters.HampelFilter) -> Windowed:
    def centre(like: Tensor) -> Centre:
        return hampel(filter.radius, filter.n_sigmas, filter.iterations)

    return Windowed(filter.radius, filter.radius, centre, filter)


def _one_euro(filter: filters.OneEuroFilter) -> Recursive:
    def machine(like: Tensor) -> OneEuro:
        return OneEuro(filter.min_cutoff, filter.beta, filter.d_cutoff, filter.frame_rate)

    return Recursive(machine)


def _kalman(filter: filters.KalmanSmoother) -> Recursive:
    def machine(like: Tensor) -> Tracker:
        ratio = noise_ratio(filter.process_noise, filter.measurement_noise, like)
        return Tracker(ratio, filter.order, like)

    return Recursive(machine)


_PLANS: dict[type[nn.Module], Callable[[Any], Windowed | Recursive]] = {
    filters.BilateralFilter: _bilateral,
    filters.GaussianFilter: _gaussian,
    filters.LinearFilter: _linear,
    filters.NonLocalPoseMeans: _nonlocal,
    filters.SavitzkyGolayFilter: _savitzky_golay,
    filters.ButterworthFilter: _butterworth,
    filters.MovingMeanFilter: _moving_mean,
    filters.MedianFilter: _median,
    filters.HampelFilter: _hampel,
    filters.OneEuroFilter: _one_euro,
    filters.KalmanSmoother: _kalman,
}

_NEED: dict[type, str] = {
    filters.AutoDenoiser: "which estimates the noise from the whole sequence",
    filters.KernelPCAFilter: "which learns poses from the whole sequence",
    filters.LiftingDenoiser: "whose thresholds come from the whole sequence",
    filters.LocalSpectrumFilter: "which estimates the noise from the whole sequence",
    filters.LowRankFilter: "which learns trajectories from the whole sequence",
    filters.OutlierRepair: "which judges samples by the whole sequence",
    filters.PrincipalComponentFilter: "which learns poses from the whole sequence",
}
