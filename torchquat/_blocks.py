"""Work cut into blocks that fit a cache."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import derivatives, visible
from torchquat._planes import Quaternion

__all__ = ["Window", "blocks", "in_windows"]

BLOCK = 2**16
"""Elements of one component in a block: a few dozen such planes fit a second-level cache."""


class Window(NamedTuple):
    """What a block reads: its own frames and ``reach`` more on either side.

    Attributes:
        q: Components of unit quaternions ``(..., frames + 2 reach, J)``.
        trust: Weights of these frames; ``None``: 1.
        items: Batch items of the block.
        start: Its first frame.
        frames: How many it has.
    """

    q: Quaternion
    trust: Tensor | None
    items: slice
    start: int
    frames: int


def in_windows(
    make: Callable[[Window], Quaternion], padded: Tensor, trust: Tensor | None, reach: int
) -> Tensor:
    """Make a sequence block by block from a padded one.

    Args:
        make: From the window around a block to the components of the block.
        padded: Unit quaternions ``(..., T + 2 reach, J, 4)``.
        trust: Weights ``(..., T + 2 reach, J)``; ``None``: 1.
        reach: Frames on either side of a block that it reads.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.
    """
    batch, frames = padded.shape[:-3], padded.shape[-3] - 2 * reach
    padded = padded.reshape(batch.numel(), *padded.shape[-3:])
    trust = None if trust is None else trust.reshape(padded.shape[:-1])

    def windowed(items: slice, start: int, frames: int) -> Quaternion:
        span = slice(start, start + frames + 2 * reach)
        q = _planes.split(padded[items, span])
        return make(Window(q, None if trust is None else trust[items, span], items, start, frames))

    result = _assemble(windowed, padded[:, :frames], reach)
    return result.reshape(*batch, *result.shape[1:])


def _assemble(make: Callable[[slice, int, int], Quaternion], like: Tensor, reach: int) -> Tensor:
    """Make a tensor block by block.

    Args:
        make: From batch items, first frame and number of frames to the components of a block.
        like: Tensor ``(N, T, J, 4)`` of the shape that is made.
        reach: As in :func:`blocks`.

    Returns:
        Tensor ``(N, T, J, 4)``.
    """
    made: list[Tensor] = []
    result = None
    for items, times in blocks(like, reach):
        row: list[Tensor] = []
        for start, frames in times:
            planes = make(items, start, frames)
            if derivatives(*planes):
                row.append(_planes.join(planes))
                continue
            if result is None:
                result = torch.empty_like(like)
            for component, plane in enumerate(planes):  # with nothing between it and its place
                result[items, start : start + frames, :, component] = plane
        made += [torch.cat(row, 1)] if row else []
    if result is not None:
        return result
    return torch.cat(made).contiguous() if made else like


def blocks(q: Tensor, reach: int) -> Iterator[tuple[slice, list[tuple[int, int]]]]:
    """Cut ``(N, T, J, 4)`` into blocks of the batch and of time.

    Args:
        q: The signal.
        reach: Frames on either side that a block of time reads besides its own.

    Yields:
        Batch items, and the first frame and number of frames of each block of time; one block
        where cutting would not help.
    """
    items, frames, joints = q.shape[:3]
    if not visible(q):
        yield slice(None), [(0, frames)]
        return
    # reading the frames around a short block costs more than what the cache gains
    length = min(frames, max(BLOCK // joints, 8 * reach, 1))
    together = max(BLOCK // (length * joints), 1)
    times = [(start, min(length, frames - start)) for start in range(0, frames, length)]
    for item in range(0, items, together):
        yield slice(item, item + together), times
