"""How far details are shrunk: noise estimates, rules for thresholds, and shrinkage by norm.

Details are rotation vectors ``(..., N, J, 3)``. Everything here goes by their norms, so that it
does not depend on the coordinate frame; every level and joint is judged by itself.
"""

import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from torchquat import _planes, timeline
from torchquat._eager import derivatives, visible
from torchquat._series import invisible, squared_arcsine

__all__ = [
    "RULES",
    "SHRINKAGES",
    "Rule",
    "Shrinkage",
    "detail_validity",
    "finest_noise",
    "kept",
    "masked_median",
    "norm",
    "shrink",
    "threshold",
    "universal_threshold",
]

Rule = Literal["universal", "sure", "bayes", "finest"]
RULES: tuple[str, ...] = get_args(Rule)
Shrinkage = Literal["soft", "hard", "garrote"]
SHRINKAGES: tuple[str, ...] = get_args(Shrinkage)

AXES = 3
_MEDIAN_NORM = 1.5381722544  # of three independent standard normal numbers
_LINEAR_GAIN = math.sqrt(1.5)  # noise of a frame minus the mean of two others


def norm(v: Tensor) -> Tensor:
    """Length of vectors ``(..., 3)``, shape ``(..., 1)``; its gradient is 0 where they vanish."""
    return _root(v.square().sum(-1, keepdim=True))


def shrink(detail: Tensor, threshold: Tensor, shrinkage: Shrinkage) -> Tensor:
    r"""Shorten details, keep their direction.

    .. math::
        \text{soft: } (1 - t/|d|)_+\, d, \quad
        \text{hard: } [|d| > t]\, d, \quad
        \text{garrote: } (1 - t^2/|d|^2)_+\, d

    Args:
        detail: Rotation vectors ``(..., N, J, 3)`` [rad].
        threshold: t, broadcastable to ``(..., N, J, 1)`` [rad]; at 0 nothing changes.
        shrinkage: Which.

    Returns:
        Rotation vectors ``(..., N, J, 3)`` [rad].
    """
    return kept(detail.square().sum(-1, keepdim=True), threshold, shrinkage) * detail


def kept(square: Tensor, threshold: Tensor, shrinkage: Shrinkage) -> Tensor:
    """The share that :func:`shrink` keeps of details with these squared norms."""
    if shrinkage != "hard" and not derivatives(square, threshold):
        return _kept((square + invisible(square)).rsqrt_().mul_(threshold), shrinkage)
    length = _root(square)
    at_zero = (threshold <= 0).to(square.dtype)
    share = threshold / torch.where(length > 0, length, 1.0)
    return torch.where(length > 0, _kept(share, shrinkage), at_zero)


def _kept(share: Tensor, shrinkage: Shrinkage) -> Tensor:
    """The share kept for this ratio of the threshold to the length."""
    if shrinkage == "hard":
        return (share < 1.0).to(share.dtype)
    return (1.0 - (share if shrinkage == "soft" else share.square())).clamp(min=0.0)


def finest_noise(q: Tensor, present: Tensor | None = None) -> Tensor:
    """Standard deviation of the noise of single frames, per axis and joint.

    From the median distance of odd frames from the middle between their neighbours: the finest
    details of the linear scheme. Those of other schemes would do, but Haar's are velocities: on
    real motion they are mostly signal.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        present: Booleans ``(..., T, J)``; details next to a missing frame do not count. ``None``:
            all are present.

    Returns:
        Standard deviations ``(..., 1, J, 1)`` [rad]; 0 where there is nothing to judge by.
    """
    even, odd = (x.movedim(-1, 0) for x in timeline.halves(q))
    second = even[..., 1:, :]  # the last odd frame may have nothing after it
    count = second.shape[-2]
    first, odd = (timeline.first_frames(x, count, -2) for x in (even, odd))
    total = first + _planes.aligned(second, first)
    middle = total * _planes.dot(total.unbind(0), total.unbind(0)).rsqrt()
    difference = _planes.aligned(odd, middle) - middle
    square = _planes.dot(difference.unbind(0), difference.unbind(0))[..., None]
    valid = detail_validity(present)[0]
    valid = None if valid is None else timeline.first_frames(valid, count, -2)
    return masked_median(square, valid, _angle) / (_MEDIAN_NORM * _LINEAR_GAIN)


def _angle(square: Tensor) -> Tensor:
    """Rotation angle [rad] of the squared difference of two unit quaternions."""
    return _root(16.0 * squared_arcsine(0.25 * square))


def detail_validity(present: Tensor | None) -> tuple[Tensor | None, Tensor | None]:
    """Which details of one level come from present frames, and which coarse frames do.

    Args:
        present: Booleans ``(..., T, J)``; ``None``: all are present, and so are the results.

    Returns:
        Booleans ``(..., floor(T / 2), J)`` and ``(..., ceil(T / 2), J)``.
    """
    if present is None:
        return None, None
    even, odd = present[..., ::2, :], present[..., 1::2, :]
    following = torch.cat([even[..., 1:, :], even[..., -1:, :]], -2)
    return odd & timeline.first_frames(even & following, odd.shape[-2], -2), even


def threshold(rule: Rule, detail: Tensor, valid: Tensor | None, sigma: Tensor) -> Tensor:
    """Threshold of one level for every joint.

    Args:
        rule: ``"universal"``: above the largest of N noise vectors (Downie and Silverman 1998);
            ``"sure"``: least unbiased risk estimate of soft shrinkage, at most the universal one
            (Stein 1981; Donoho and Johnstone 1995, here for vectors); ``"bayes"``: the noise's
            variance over the signal's standard deviation (Chang, Yu and Vetterli 2000, times the
            root of three for the norm of three axes).
        detail: Rotation vectors ``(..., N, J, 3)`` [rad].
        valid: Which of them count, booleans ``(..., N, J)``; ``None``: all.
        sigma: Standard deviation of the noise per axis, ``(..., 1, J, 1)`` [rad].

    Returns:
        Thresholds ``(..., 1, J, 1)`` [rad].
    """
    counted = detail.new_ones(detail.shape[:-1]) if valid is None else valid.to(detail.dtype)
    count = counted[..., None].sum(-3, keepdim=True)
    if rule == "universal":
        return universal_threshold(count, sigma)
    length, valid = norm(detail), counted[..., None] > 0
    if rule == "sure":
        return torch.minimum(_least_risk(length, valid, sigma), universal_threshold(count, sigma))
    assert rule == "bayes"
    return _bayes(length, valid, sigma, count)


def universal_threshold(count: Tensor, sigma: Tensor) -> Tensor:
    """Threshold above the largest of so many noise vectors, ``(..., 1, J, 1)`` each."""
    return sigma * _universal_factor(count)


def _universal_factor(count: Tensor) -> Tensor:
    logarithm = count.clamp(min=math.e).log()
    return (2.0 * logarithm + (AXES - 2) * logarithm.log()).sqrt()


def _least_risk(length: Tensor, valid: Tensor, sigma: Tensor) -> Tensor:
    """Threshold with the least Stein estimate, among 0 and the norms themselves."""
    ordered, counts = _sorted(length, valid)
    zero = torch.zeros_like(sigma)  # the threshold that leaves everything as it is
    ordered, counts = torch.cat([zero, ordered], -3), torch.cat([zero, counts], -3)
    variance = sigma.square()
    inverse = counts / torch.where(ordered > 0, ordered, 1.0)
    inside = (counts * (ordered.square() - AXES * variance)).cumsum(-3)
    outside = counts.sum(-3, keepdim=True) - counts.cumsum(-3)
    beyond = inverse.sum(-3, keepdim=True) - inverse.cumsum(-3)
    risk = inside + outside * (ordered.square() + AXES * variance)
    risk = risk - 2.0 * (AXES - 1) * variance * ordered * beyond
    candidates = torch.cat([zero + 1.0, counts[..., 1:, :, :]], -3) > 0
    risk = torch.where(candidates, risk.detach(), torch.inf)
    return ordered.gather(-3, risk.argmin(-3, keepdim=True))


def _bayes(length: Tensor, valid: Tensor, sigma: Tensor, count: Tensor) -> Tensor:
    square = torch.where(valid, length.square(), 0.0)
    power = square.sum(-3, keepdim=True) / (AXES * count.clamp(min=1.0))
    signal = power - sigma.square()
    # where nothing stands above the noise, everything goes
    lengths = torch.cat([torch.zeros_like(sigma), torch.where(valid, length, 0.0)], -3)
    largest = lengths.amax(-3, keepdim=True)  # 0 where there is nothing
    above = signal > torch.finfo(length.dtype).eps * power
    ratio = sigma.square() / torch.where(above, signal, 1.0).sqrt()
    return torch.where(above, torch.minimum(math.sqrt(AXES) * ratio, largest), largest)


def _sorted(length: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Norms in rising order, those that do not count last, and 1 where they count."""
    key = torch.where(valid, length, torch.inf).detach()
    order = key.sort(-3).indices
    counts = valid.to(length.dtype).gather(-3, order)
    return length.gather(-3, order) * counts, counts


def masked_median(
    x: Tensor, valid: Tensor | None = None, rising: Callable[[Tensor], Tensor] | None = None
) -> Tensor:
    """Median over time of what is valid, 0 of nothing.

    Args:
        x: Values ``(..., N, J, 1)`` >= 0.
        valid: Booleans ``(..., N, J)``; ``None``: all.
        rising: A rising function: the median is that of its values, found without them.

    Returns:
        Medians ``(..., 1, J, 1)``.
    """
    frames = x.shape[-3]
    whole = valid is None or (visible(valid) and bool(valid.all()))
    if frames > 0 and whole and visible(x):  # without sorting all of it
        low, high = _ranked(x, ((frames - 1) // 2, frames // 2))
        count = torch.full_like(low, frames)
    else:
        known = torch.ones_like(x, dtype=torch.bool) if valid is None else valid[..., None]
        ordered, counts = _sorted(x, known)
        ordered = torch.cat([ordered, torch.zeros_like(ordered.sum(-3, keepdim=True))], -3)
        count = counts.sum(-3, keepdim=True).long()
        places = (count - 1).clamp(min=0) // 2, count // 2
        low, high = (ordered.gather(-3, place) for place in places)
    if rising is not None:
        low, high = rising(low), rising(high)
    return torch.where(count > 0, 0.5 * (low + high), 0.0)


def _ranked(x: Tensor, ranks: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Values ``(..., 1, J, 1)`` of two ranks along time, by NumPy: several times faster."""
    parted = np.partition(x.detach().movedim(-3, -1).contiguous().numpy(), ranks, axis=-1)
    low, high = (torch.from_numpy(parted[..., rank].copy()).unsqueeze(-3) for rank in ranks)
    if derivatives(x):
        low, high = (
            x.gather(-3, (x == value).int().argmax(-3, keepdim=True)) for value in (low, high)
        )
    return low, high


def _root(x: Tensor) -> Tensor:
    """Square root; its gradient is 0 at 0."""
    return torch.where(x > 0, torch.where(x > 0, x, 1.0).sqrt(), 0.0)
