"""What may be done only where Python runs the operations one by one, on a CPU.

There a value can be looked at for nothing, and work cut to the size of a cache. On a GPU both would
stall it, and in a compiler or a function transform the program must not depend on values.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

__all__ = ["blocks", "known_false"]

BLOCK = 2**15
"""Elements of one component in a block: a few dozen such planes fit a second-level cache."""


def known_false(flags: Tensor) -> bool:
    """Whether all flags can be seen to be False; False also means that nobody looked."""
    if flags.device.type != "cpu" or torch.compiler.is_compiling():
        return False
    try:
        return not bool(flags.any())
    except RuntimeError:  # inside vmap
        return False


def blocks(q: Tensor) -> Iterator[tuple[int, int]]:
    """Cut the frames of ``(..., T, J, 4)`` into blocks.

    Yields:
        First frame and number of frames of each block; one block where cutting would not help.
    """
    frames = q.shape[-3]
    if torch.compiler.is_compiling() or q.device.type != "cpu":
        yield 0, frames
        return
    size = max(BLOCK * max(frames, 1) // max(q[..., 0].numel(), 1), 1)
    for start in range(0, max(frames, 1), size):
        yield start, min(size, frames - start)
