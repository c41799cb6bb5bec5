"""How far details are shrunk: noise estimates, rules for thresholds, and shrinkage by norm.

Details are rotation vectors ``(..., N, J, 3)``. Everything here goes by their norms, so that it
does not depend on the coordinate frame; every level and joint is judged by itself.
"""

import math
from typing import Literal, get_args

import torch
from torch import Tensor

from torchquat import so3, timeline
from torchquat._eager import visible
from torchquat.filters.lifting import LinearPredict

__all__ = [
    "RULES",
    "SHRINKAGES",
    "Rule",
    "Shrinkage",
    "detail_validity",
    "finest_noise",
    "masked_median",
    "norm",
    "shrink",
    "threshold",
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
    square = v.square().sum(-1, keepdim=True)
    apart = square > 0
    return torch.where(apart, torch.where(apart, square, 1.0).sqrt(), 0.0)


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
    length = norm(detail)
    share = threshold / torch.where(length > 0, length, 1.0)
    if shrinkage == "hard":
        factor = (length > threshold).to(detail.dtype)
    else:
        factor = (1.0 - (share if shrinkage == "soft" else share.square())).clamp(min=0.0)
    at_zero = (threshold <= 0).to(detail.dtype)
    return torch.where(length > 0, factor, at_zero) * detail


def finest_noise(q: Tensor, present: Tensor) -> Tensor:
    """Standard deviation of the noise of single frames, per axis and joint.

    From the median norm of the finest details of the linear scheme. Those of other schemes would
    do, but Haar's are velocities: on real motion they are mostly signal.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        present: Booleans ``(..., T, J)``; details next to a missing frame do not count.

    Returns:
        Standard deviations ``(..., 1, J, 1)`` [rad]; 0 where there is nothing to judge by.
    """
    even, odd = q[..., ::2, :, :], q[..., 1::2, :, :]
    predicted = timeline.first_frames(LinearPredict()(even), odd.shape[-3])
    length = norm(so3.between(predicted, odd))
    valid, _ = detail_validity(present)
    return masked_median(length, valid[..., None]) / (_MEDIAN_NORM * _LINEAR_GAIN)


def detail_validity(present: Tensor) -> tuple[Tensor, Tensor]:
    """Which details of one level come from present frames, and which coarse frames do.

    Args:
        present: Booleans ``(..., T, J)``.

    Returns:
        Booleans ``(..., floor(T / 2), J)`` and ``(..., ceil(T / 2), J)``.
    """
    even, odd = present[..., ::2, :], present[..., 1::2, :]
    following = torch.cat([even[..., 1:, :], even[..., -1:, :]], -2)
    return odd & timeline.first_frames(even & following, odd.shape[-2], -2), even


def threshold(rule: Rule, length: Tensor, valid: Tensor, sigma: Tensor) -> Tensor:
    """Threshold of one level for every joint.

    Args:
        rule: ``"universal"``: above the largest of N noise vectors (Downie and Silverman 1998);
            ``"sure"``: least unbiased risk estimate of soft shrinkage, at most the universal one
            (Stein 1981; Donoho and Johnstone 1995, here for vectors); ``"bayes"``: the noise's
            variance over the signal's standard deviation (Chang, Yu and Vetterli 2000, times the
            root of three for the norm of three axes).
        length: Norms of the details ``(..., N, J, 1)`` [rad].
        valid: Which of them count, booleans of the same shape.
        sigma: Standard deviation of the noise per axis, ``(..., 1, J, 1)`` [rad].

    Returns:
        Thresholds ``(..., 1, J, 1)`` [rad].
    """
    count = valid.sum(-3, keepdim=True).to(length.dtype)
    universal = sigma * _universal_factor(count)
    if rule == "universal":
        return universal
    if rule == "sure":
        return torch.minimum(_least_risk(length, valid, sigma), universal)
    assert rule == "bayes"
    return _bayes(length, valid, sigma, count)


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
    order = key.argsort(dim=-3, stable=True)
    counts = valid.to(length.dtype).gather(-3, order)
    return length.gather(-3, order) * counts, counts


def masked_median(x: Tensor, valid: Tensor) -> Tensor:
    """Median over time of what is valid, ``(..., N, J, 1)`` to ``(..., 1, J, 1)``; 0 of nothing."""
    frames = x.shape[-3]
    if frames > 0 and visible(valid) and bool(valid.all()):  # without sorting all of it
        ranks = ((frames + 1) // 2, frames // 2 + 1)
        low, high = (x.kthvalue(rank, dim=-3, keepdim=True).values for rank in ranks)
        return 0.5 * (low + high)
    ordered, counts = _sorted(x, valid)
    ordered = torch.cat([ordered, torch.zeros_like(ordered.sum(-3, keepdim=True))], -3)
    count = counts.sum(-3, keepdim=True).long()
    low, high = (count - 1).clamp(min=0) // 2, count // 2
    middle = 0.5 * (ordered.gather(-3, low) + ordered.gather(-3, high))
    return torch.where(count > 0, middle, 0.0)
