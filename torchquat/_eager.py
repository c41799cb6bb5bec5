"""What may be done only where Python runs the operations one by one, on a CPU.

There a value can be looked at for nothing, and work cut to the size of a cache. On a GPU both would
stall it, and in a compiler or a function transform the program must not depend on values.
"""

import math

import torch
from torch import Tensor
from torch.autograd import forward_ad

__all__ = ["derivatives", "eager", "highest", "lowest", "numbers", "recorded", "visible"]

_transforms_active = getattr(torch._C, "_are_functorch_transforms_active", lambda: True)


def derivatives(*inputs: Tensor) -> bool:
    """Whether derivatives of what is computed from these tensors may be asked for."""
    if torch.compiler.is_compiling() or _transforms_active():
        return True
    if forward_ad._current_level >= 0:
        return True
    return torch.is_grad_enabled() and any(x.requires_grad for x in inputs)


def recorded(*inputs: Tensor) -> bool:
    """Whether operations are recorded one by one for a backward pass, and nothing else is done."""
    if not torch.is_grad_enabled() or not any(x.requires_grad for x in inputs):
        return False
    return not (
        torch.compiler.is_compiling() or _transforms_active() or forward_ad._current_level >= 0
    )


def lowest(x: Tensor) -> float:
    """The smallest value; NaN if one is, and where nobody may look."""
    return float(x.detach().min()) if visible(x) else math.nan


def highest(x: Tensor) -> float:
    """The largest value; NaN if one is, and where nobody may look."""
    return float(x.detach().max()) if visible(x) else math.nan


def numbers(rows: Tensor) -> list[float] | tuple[Tensor, ...]:
    """Rows of ``(N, J)``: numbers, where they can be seen, are one each, and get no gradient."""
    if rows.shape[1] == 1 and visible(rows) and not derivatives(rows):
        return rows[:, 0].tolist()
    return rows.unbind(0)


def visible(x: Tensor) -> bool:
    """Whether a value may be looked at, and a program depend on it."""
    return x.device.type == "cpu" and x.numel() > 0 and eager()


def eager() -> bool:
    """Whether Python runs the operations one by one, on any device."""
    return not (torch.compiler.is_compiling() or _transforms_active())
