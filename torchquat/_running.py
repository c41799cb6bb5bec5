"""Running maxima and products along time, also for programs that leave PyTorch.

ONNX has a running sum, but no running maximum or product. An exported program makes them by
doubling: after step ``n`` an entry covers the ``2^n`` entries up to its own. The number of steps
does not depend on the length, which may be dynamic.
"""

from collections.abc import Callable

import torch
from torch import Tensor

__all__ = ["LONGEST", "doublings", "running_maximum", "running_minimum", "running_product"]

_STEPS = [2**n for n in range(20)]
LONGEST = 2 * _STEPS[-1]
"""Frames that an exported program covers: 2.4 hours at 120 frames a second."""


def _exporting() -> bool:
    """Whether a program is made that leaves PyTorch.

    Read from the flag itself: up to torch 2.12 ``torch.compile`` takes ``is_exporting()`` for true.
    Before torch 2.7 nothing tells the two apart.
    """
    flag = getattr(torch.compiler, "_is_exporting_flag", None)
    return torch.compiler.is_compiling() if flag is None else flag


def doublings(frames: int) -> list[int]:
    """Steps that together cover so many frames; compiled programs make those of any length."""
    if torch.compiler.is_compiling():
        return _STEPS
    return [step for step in _STEPS if step < frames]


def running_maximum(x: Tensor, dim: int) -> Tensor:
    """The largest of all entries up to each."""
    if not _exporting():
        return x.cummax(dim).values
    return _doubled(x, dim, torch.maximum)


def running_minimum(x: Tensor, dim: int) -> Tensor:
    """The smallest of all entries up to each."""
    if not _exporting():
        return x.cummin(dim).values
    return _doubled(x, dim, torch.minimum)


def running_product(x: Tensor, dim: int) -> Tensor:
    """The product of all entries up to each."""
    if not _exporting():
        return x.cumprod(dim)
    shape = [1] * x.dim()
    shape[dim] = -1
    entry = torch.arange(x.shape[dim], device=x.device).view(shape)
    for step in _STEPS:
        x = torch.where(entry >= step, x * _earlier(x, dim, step), x)
    return x


def _doubled(x: Tensor, dim: int, larger: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    for step in _STEPS:
        x = larger(x, _earlier(x, dim, step))  # the first entry counts for all
    return x


def _earlier(x: Tensor, dim: int, step: int) -> Tensor:
    """Entries ``step`` before, or the first where there is none."""
    entry = torch.arange(x.shape[dim], device=x.device)
    return x.index_select(dim, (entry - step).clamp(min=0))
