"""Work cut into blocks that fit a cache."""

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import derivatives, visible
from torchquat._planes import Quaternion

__all__ = ["assemble", "block_times", "blocks"]

BLOCK = 2**16
"""Elements of one component in a block: a few dozen such planes fit a second-level cache."""


def assemble(make: Callable[[slice, int, int], Quaternion], like: Tensor, reach: int) -> Tensor:
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
    return torch.cat(made) if made else like


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


def block_times(q: Tensor, reach: int) -> list[tuple[int, int]]:
    """Cut ``(..., T, J, 4)`` into blocks of time; as :func:`blocks`, the batch uncut."""
    shape = q.shape
    if not visible(q):
        return [(0, shape[-3])]
    length = max(BLOCK // max(q[..., :1, :, 0].numel(), 1), 8 * reach, 1)
    return [(start, min(length, shape[-3] - start)) for start in range(0, shape[-3], length)]
