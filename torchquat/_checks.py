"""What every public function accepts, said in one sentence when it is something else."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat._eager import visible

__all__ = [
    "check_choice",
    "check_count",
    "check_frame",
    "check_layout",
    "check_positive",
    "check_signal",
]


def check_layout(q: Tensor, name: str = "q") -> None:
    """Raise unless ``q`` is a floating-point tensor ``(..., T, J, 4)``."""
    if not isinstance(q, Tensor):
        raise TypeError(f"{name} must be a torch.Tensor, got {type(q).__name__}.")
    if not q.is_floating_point():
        raise TypeError(f"{name} must be a floating-point tensor, got {q.dtype}.")
    if q.dim() < 3 or q.shape[-1] != 4:
        hint = ""
        if q.dim() == 2 and q.shape[-1] == 4:
            hint = f" For one joint add a joint axis: {name}[:, None, :]."
        raise ValueError(f"{name} must have shape (..., T, J, 4), got {tuple(q.shape)}.{hint}")


def check_signal(q: Tensor, weight: Tensor | None) -> None:
    """Raise unless ``q`` is ``(..., T, J, 4)`` and ``weight`` fits it, where there is one."""
    check_layout(q)
    if weight is not None:
        _check_weight(weight, q)


def check_frame(frame: Tensor, weight: Tensor | None) -> None:
    """Raise unless ``frame`` is a floating-point tensor ``(..., J, 4)``, and ``weight`` fits it."""
    if not isinstance(frame, Tensor):
        raise TypeError(f"frame must be a torch.Tensor, got {type(frame).__name__}.")
    if not frame.is_floating_point():
        raise TypeError(f"frame must be a floating-point tensor, got {frame.dtype}.")
    if frame.dim() < 2 or frame.shape[-1] != 4:
        raise ValueError(f"frame must have shape (..., J, 4), got {tuple(frame.shape)}.")
    if weight is not None:
        _check_weight(weight, frame, "frame", "(..., J)")


def _check_weight(weight: Tensor, q: Tensor, name: str = "q", layout: str = "(..., T, J)") -> None:
    """Raise unless ``weight`` is a mask or confidence that broadcasts to ``q.shape[:-1]``."""
    if not isinstance(weight, Tensor):
        raise TypeError(f"weight must be a torch.Tensor, got {type(weight).__name__}.")
    if weight.dtype not in (torch.bool, q.dtype):
        raise TypeError(
            f"weight must have dtype torch.bool or {q.dtype} as {name}, got {weight.dtype}."
        )
    if weight.device != q.device:
        raise ValueError(f"weight must be on {q.device} as {name}, got {weight.device}.")
    target = q.shape[:-1]
    fits = weight.dim() <= len(target) and all(
        size in (1, wanted)
        for size, wanted in zip(reversed(weight.shape), reversed(target), strict=False)
    )
    if not fits:
        raise ValueError(
            f"weight must broadcast to {layout} = {tuple(target)}, got {tuple(weight.shape)}."
        )


def check_positive(name: str, value: float | Sequence[float] | Tensor) -> None:
    """Raise unless ``value``, one number or one per joint, is finite and > 0.

    Tensors are looked at where that costs nothing: not on a GPU, and not while compiling.
    """
    if isinstance(value, Tensor):
        if value.dim() > 1:
            raise ValueError(
                f"{name} must be one value or one per joint, got {tuple(value.shape)}."
            )
        if visible(value) and not bool((value.isfinite() & (value > 0)).all()):
            raise ValueError(f"{name} must be finite and > 0, got {value.tolist()}.")
        return
    values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    for number in values:
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            raise TypeError(f"{name} must be a number or one number per joint, got {value!r}.")
        if not (math.isfinite(number) and number > 0):
            raise ValueError(f"{name} must be finite and > 0, got {value!r}.")
    if not values:
        raise ValueError(f"{name} must be one value or one per joint, got {value!r}.")


def check_count(name: str, value: int, minimum: int) -> None:
    """Raise unless ``value`` is an integer >= ``minimum``."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{name} must be an integer, got {value!r}.")
    if value < minimum:
        raise ValueError(f"{name} must be >= {minimum}, got {value}.")


def check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Raise unless ``value`` is one of ``choices``."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}.")
