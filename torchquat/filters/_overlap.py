"""Overlapping windows of time: where they lie, what they see, and one answer out of many."""

import torch
from torch import Tensor

__all__ = ["blended", "centred", "cut", "frames_of", "larger", "smaller"]


def smaller(a: int, b: int) -> int:
    """The smaller length, of an open one too."""
    return torch.sym_min(a, b)  # pyright: ignore[reportReturnType]


def larger(a: int, b: int) -> int:
    """The larger length, of an open one too."""
    return torch.sym_max(a, b)  # pyright: ignore[reportReturnType]


def frames_of(count: int, frames: int, size: int, device: torch.device) -> Tensor:
    """Frames ``(count, size)`` of an even number of windows, evenly spread, symmetric in time."""
    beyond = frames - size
    index = torch.arange(count, device=device)
    ahead = index * beyond // (count - 1)
    back = beyond - (count - 1 - index) * beyond // (count - 1)
    start = torch.where(2 * index < count, ahead, back)
    return start[:, None] + torch.arange(size, device=device)


def cut(x: Tensor, frame: Tensor) -> Tensor:
    """What every window sees of ``(N, T, C)``: ``(N windows, W, C)``."""
    return x.index_select(1, frame.flatten()).reshape(-1, frame.shape[1], x.shape[2])


def centred(part: Tensor) -> Tensor:
    """Windows ``(N, W, C)`` without their means."""
    return part - part.mean(1, keepdim=True)


def blended(part: Tensor, taper: Tensor, frame: Tensor, shape: torch.Size) -> Tensor:
    """Means of what all windows say about a frame.

    Args:
        part: What they say, ``(N windows, W, C)``.
        taper: How much each of their places counts, ``(W, 1)``.
        frame: The frame of each place, ``(windows, W)``.
        shape: Begins with ``(N, T)``.

    Returns:
        Means ``(N, T, C)``.
    """
    batch, frames = shape[:2]
    places = frame.flatten()
    ahead = (taper * part).reshape(batch, -1, part.shape[-1])
    weight = taper.expand(frame.shape[0], -1, -1).reshape(-1, 1)
    total = _summed(ahead.movedim(1, 0), places, frames).movedim(0, 1)
    return total / _summed(weight, places, frames)


def _summed(x: Tensor, places: Tensor, frames: int) -> Tensor:
    """Sums ``(T, ...)`` of the rows ``(places, ...)`` that belong to each frame."""
    nothing = x.new_zeros(frames, *x.shape[1:])
    if x.is_cuda:  # where index_add adds in any order, so that two calls differ
        return nothing.index_put((places,), x, accumulate=True)
    return nothing.index_add(0, places, x)
