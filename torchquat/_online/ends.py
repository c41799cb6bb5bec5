"""Frames whose window is not all there: the filter itself, by its boundary rule."""

import torch
from torch import Tensor, nn

from torchquat import missing
from torchquat._online.cascade import Windowed
from torchquat._online.frames import Frames

__all__ = ["at_the_end", "at_the_start"]


def at_the_start(windowed: Windowed, frames: Frames, age: Tensor, out: Tensor) -> Tensor:
    """Results ``(4, P, J)``, put right where the window reaches before the first frame.

    Args:
        windowed: The filter.
        frames: The last frames of P people.
        age: How many each has, ``(P,)``, counted up to the width of the window.
        out: Results that hold for whole windows.

    Returns:
        Results ``(4, P, J)``; not a number where no result is due.
    """
    for count in sorted(set(age.tolist())):
        if count >= windowed.width:
            continue
        people = (age == count).nonzero()[:, 0]
        due = count - 1 - windowed.latency
        if due < 0:
            out = out.index_fill(1, people, torch.nan)
        else:
            own = _filtered(windowed.start or windowed.ends, frames, people, count)
            out = out.index_copy(1, people, own[:, :, due])
    return out


def at_the_end(windowed: Windowed, frames: Frames, age: Tensor, due: int) -> Tensor:
    """The last ``due`` results ``(4, P, due, J)``; not a number before someone's first frame."""
    out = frames.q.new_full((*frames.q.shape[:2], due, frames.q.shape[-1]), torch.nan)
    for count in sorted(set(age.tolist()) - {0}) if due else []:
        people = (age == count).nonzero()[:, 0]
        own = _filtered(windowed.ends, frames, people, count)[:, :, -due:]
        some = torch.full_like(out.index_select(1, people), torch.nan)
        some[:, :, due - own.shape[2] :] = own
        out = out.index_copy(1, people, some)
    return out


def _filtered(filter: nn.Module, frames: Frames, people: Tensor, count: int) -> Tensor:
    """The last ``count`` frames of some people, filtered as a whole, ``(4, P, count, J)``."""
    start = frames.q.shape[-2] - count
    q = frames.q[..., start:, :].index_select(1, people)
    trust = frames.trust[:, start:].index_select(0, people)
    if count == frames.q.shape[-2]:
        # what the first frame is filled with comes from before: no result due has it in its window
        least = missing.weight_range(trust.dtype)[0]
        trust = torch.cat([trust[:, :1].clamp(min=least), trust[:, 1:]], 1)
    return filter(q.movedim(0, -1), trust).movedim(-1, 0)
