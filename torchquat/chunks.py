"""Long sequences in pieces: memory that does not grow with the length."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchquat import missing
from torchquat._checks import check_count, check_signal
from torchquat._online.cascade import Windowed
from torchquat._online.rules import plan
from torchquat._running import running_maximum, running_minimum
from torchquat.filters import HampelFilter

__all__ = ["Reach", "in_chunks", "window_of"]

CHUNK = 2**19
"""Rotations in a chunk: some hundred MiB of what a filter computes from them."""


def in_chunks(
    filter: nn.Module, q: Tensor, weight: Tensor | None = None, *, frames: int | None = None
) -> Tensor:
    """Filter a sequence of any length piece by piece, to the same result.

    Every piece is read with as many frames on either side as its results depend on, and on to the
    next present frames where some are missing there. A gap of any length is filled as in the
    whole; memory grows with the longest one.

    Args:
        filter: One whose results depend on a window only; see :func:`window_of`.
        q: Quaternions ``(..., T, J, 4)`` of any norm.
        weight: Confidence, broadcastable to ``(..., T, J)``, >= 0.
        frames: Of a piece, >= 1; ``None``: as many as half a million rotations have.

    Returns:
        Unit quaternions ``(..., T, J, 4)``, without gradients.

    Raises:
        TypeError: If the filter needs the whole sequence, or ``q`` or ``weight`` is not a tensor
            of a fitting dtype.
        ValueError: If a shape, a range or one of the filter's settings does not fit.
    """
    check_signal(q, weight)
    window = window_of(filter)
    if frames is None:
        beyond = (window.past + window.future) * window.passes
        frames = max(CHUNK // max(q[..., :1, :, 0].numel(), 1), 8 * beyond, 1)
    check_count("frames", frames, 1)
    length = q.shape[-3]
    if weight is not None:
        weight = weight.expand(q.shape[:-1])
    with torch.no_grad():
        if length <= frames:
            return filter(q, weight)
        gaps = _Gaps(missing.validity(q, weight))
        result = torch.empty_like(q, memory_format=torch.contiguous_format)
        for start in range(0, length, frames):
            stop = min(start + frames, length)
            first, last = gaps.around(start, stop - 1, window)
            piece = slice(first, last + 1)
            known = None if weight is None else weight[..., piece, :]
            made = filter(q[..., piece, :, :], known)
            result[..., start:stop, :, :] = made[..., start - first : stop - first, :, :]
    return result


class Reach(NamedTuple):
    """What the result of a frame depends on.

    Attributes:
        past: Frames before it, in each pass.
        future: Frames after it, in each pass.
        passes: How often the window is applied.
    """

    past: int
    future: int
    passes: int


def window_of(filter: nn.Module) -> Reach:
    """What a filter reads for the result of a frame, besides the frames that fill missing ones.

    Raises:
        TypeError: If it depends on the whole sequence, or on all that was before.
        ValueError: If one of its settings needs the whole sequence.
    """
    found = plan(filter)
    if not isinstance(found, Windowed):
        why = "which carries an estimate from frame to frame"
    elif isinstance(filter, HampelFilter):
        why = "which fills outliers from the next frames that are none, however far"
    else:
        # a fit to the first or last window gives all frames of its half
        fit = 2 if getattr(filter, "boundary", None) == "interp" else 1
        return Reach(fit * found.past, fit * found.future, found.passes)
    raise TypeError(f"filter must see a window only, got {type(filter).__name__}, {why}.")


class _Gaps:
    """Where present frames lie around those that are missing.

    Args:
        present: Booleans ``(..., T, J)``.
    """

    def __init__(self, present: Tensor) -> None:
        self.last = present.shape[-2] - 1
        self.whole = bool(present.all())
        if not self.whole:
            columns = present.movedim(-2, 0).flatten(1)
            frame = torch.arange(len(columns), device=present.device)[:, None]
            self.before = running_maximum(torch.where(columns, frame, -1), 0)
            after = torch.where(columns, frame, len(columns)).flip(0)
            self.after = running_minimum(after, 0).flip(0)

    def around(self, first: int, last: int, window: Reach) -> tuple[int, int]:
        """The frames to read for the results of ``first`` to ``last``.

        Every pass reads its window, and what fills the missing frames in it anew.
        """
        for _ in range(window.passes):
            first, last = max(first - window.past, 0), min(last + window.future, self.last)
            if not self.whole:
                before, after = self.before[first], self.after[last]
                first = int(torch.where(before >= 0, before, first).min())
                last = int(torch.where(after <= self.last, after, last).max())
        return first, last
