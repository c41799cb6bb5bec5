"""Compression, features and editing on lifting details: what a :class:`Pyramid` is good for."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat.filters._thresholds import masked_median, norm
from torchquat.filters.lifting import Pyramid

__all__ = ["compress", "salience", "scale_details", "stored_share"]


def compress(pyramid: Pyramid, keep: float) -> Pyramid:
    """Keep the largest details and set all others to 0.

    A detail of a level counts by the frames that it moves: its norm times the root of their number.

    Args:
        pyramid: What :class:`LiftingTransform` made of a motion.
        keep: Share of the detail vectors of each batch item that stay, in [0, 1].

    Returns:
        A pyramid of the same shape; see :func:`stored_share` for what is left to store.

    Raises:
        ValueError: If ``keep`` lies outside [0, 1].
    """
    if not 0.0 <= keep <= 1.0:
        raise ValueError(f"keep must be in [0, 1], got {keep}.")
    levels = len(pyramid.details)
    scaled = [
        norm(detail) * 2.0 ** (0.5 * (levels - level))
        for level, detail in enumerate(pyramid.details)
    ]
    if not scaled:
        return pyramid
    everything = torch.cat([each.flatten(-3) for each in scaled], -1)
    total = everything.shape[-1]
    dropped = total - round(keep * total)
    if dropped == 0:
        return pyramid
    # by rank: equal ones are not all alike
    largest = everything.sort(dim=-1, stable=True).indices[..., dropped:]
    stays = torch.zeros_like(everything, dtype=torch.bool).scatter(-1, largest, True)
    parts = stays.split([each.shape[-3:].numel() for each in scaled], -1)
    details = zip(pyramid.details, scaled, parts, strict=True)
    kept = (torch.where(part.reshape(each.shape), d, 0.0) for d, each, part in details)
    return Pyramid(pyramid.approx, tuple(kept))


def stored_share(pyramid: Pyramid) -> Tensor:
    """Share of rotations that must be stored: coarse frames and details that are not 0.

    Args:
        pyramid: As :func:`compress` gives it.

    Returns:
        Shares ``(...)`` in [0, 1]; the compression ratio is the inverse.
    """
    stored = [(detail != 0).any(-1).sum((-2, -1)) for detail in pyramid.details]
    coarse, joints = pyramid.approx.shape[-3:-1]
    if not stored:
        return pyramid.approx.new_ones(pyramid.approx.shape[:-3])
    kept = sum(stored, torch.full_like(stored[0], coarse * joints))
    return kept.to(pyramid.approx.dtype) / max(_frames(pyramid) * joints, 1)


def salience(pyramid: Pyramid) -> Tensor:
    """How far details stand out at every frame: steps and impacts, not smooth motion.

    Each detail is measured by the median of those of its level and joint that are not 0: a joint
    may rest for most of the time. A frame gets the mean over the levels of the detail whose pair of
    frames it lies in.

    Args:
        pyramid: What :class:`LiftingTransform` made of a motion.

    Returns:
        Values ``(..., T, J)`` >= 0, around 1 where nothing stands out.
    """
    levels = len(pyramid.details)
    frames = _frames(pyramid)
    total = pyramid.approx.new_zeros(*pyramid.approx.shape[:-3], frames, pyramid.approx.shape[-2])
    for level, detail in enumerate(pyramid.details):
        length = norm(detail)
        usual = masked_median(length, length[..., 0] > 0)
        ratio = torch.where(usual > 0, length / torch.where(usual > 0, usual, 1.0), 0.0)[..., 0]
        spread = ratio.repeat_interleave(2 ** (levels - level), -2)[..., :frames, :]
        missing = frames - spread.shape[-2]
        total = total + torch.cat(
            [spread, spread.new_zeros(*total.shape[:-2], missing, total.shape[-1])], -2
        )
    return total / max(levels, 1)


def scale_details(pyramid: Pyramid, gains: Sequence[float]) -> Pyramid:
    """Edit a motion at several resolutions: multiply the details of every level.

    Args:
        pyramid: What :class:`LiftingTransform` made of a motion.
        gains: One factor per level, coarsest first: above 1 exaggerates, below 1 calms, 0 removes.

    Returns:
        The edited pyramid.

    Raises:
        ValueError: If there is not one gain per level.
    """
    if len(gains) != len(pyramid.details):
        raise ValueError(
            f"gains must have one value per level ({len(pyramid.details)}), got {len(gains)}."
        )
    details = zip(gains, pyramid.details, strict=True)
    return Pyramid(pyramid.approx, tuple(gain * detail for gain, detail in details))


def _frames(pyramid: Pyramid) -> int:
    """Length of the motion that was split: every detail stands for one frame."""
    return pyramid.approx.shape[-3] + sum(detail.shape[-3] for detail in pyramid.details)
