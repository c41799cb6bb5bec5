"""Bandwidths: one value or one per joint, kept as logarithms so that they stay positive."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchquat._checks import check_positive
from torchquat._eager import derivatives, visible

__all__ = ["Bandwidth", "default_radius", "per_joint", "register_bandwidth", "shown"]

Bandwidth = float | Sequence[float] | Tensor

ROUNDING = 1e-6


def per_joint(name: str, value: Bandwidth, like: Tensor) -> float | Tensor:
    """A number, or a tensor that broadcasts to ``(..., T, J)``, in the dtype of ``like``."""
    if isinstance(value, (int, float)):
        return float(value)
    if isinstance(value, Tensor) and value.dim() == 0 and visible(value) and not derivatives(value):
        return float(value)
    joints = like.shape[-2]
    if not isinstance(value, Tensor) or value.dim():
        if len(value) not in (1, joints):
            raise ValueError(f"{name} must be one value or one per joint ({joints}), got {value}.")
    # straight to the dtype: a detour over float32 would cost 1e-8 of every number in a list
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)


def shown(value: Tensor) -> str:
    """A bandwidth as it was typed, for ``repr``: float32 turns 0.1 into 0.10000000149."""
    numbers = [f"{number:.4g}" for number in value.reshape(-1).tolist()]
    return f"[{', '.join(numbers)}]" if value.dim() else numbers[0]


def default_radius(sigma_t: Bandwidth) -> int:
    """Half-width of a window that holds three temporal bandwidths, the widest joint's."""
    sizes = torch.as_tensor(sigma_t, dtype=torch.float64, device="cpu")
    # what rounding has added, of seconds times frame rates too, makes no window wider
    return math.ceil(3.0 * float(sizes.max()) * (1.0 - ROUNDING))


def register_bandwidth(module: nn.Module, name: str, value: Bandwidth, learnable: bool) -> None:
    """Give ``module`` the checked bandwidth as ``log_<name>``: a parameter or a buffer."""
    check_positive(name, value)
    logarithm = torch.as_tensor(value, dtype=torch.float32).detach().log()
    if not bool(logarithm.isfinite().all()):
        raise ValueError(f"{name} must be finite and > 0, got {value}.")
    if learnable:
        module.register_parameter(f"log_{name}", nn.Parameter(logarithm))
    else:
        module.register_buffer(f"log_{name}", logarithm)
