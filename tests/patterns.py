"""Patterns of confidence and of missing frames that every filter is tried with."""

import torch
from torch import Tensor

PATTERNS = ("none", "confidence", "gaps", "ends", "half", "joint", "nan", "odd")


def with_pattern(q: Tensor, pattern: str, rng: torch.Generator) -> tuple[Tensor, Tensor | None]:
    """The motion ``(T, J, 4)`` and its weights under a pattern."""
    frames, joints = q.shape[-3:-1]
    q = q.clone()
    weight = torch.ones(frames, joints, dtype=q.dtype)
    if pattern == "none":
        return q, None
    if pattern == "confidence":
        return q, torch.rand(frames, joints, generator=rng, dtype=q.dtype)
    if pattern == "gaps":
        return q, torch.rand(frames, joints, generator=rng) > 0.4
    if pattern == "ends":
        weight[[0, -1]] = 0.0
    if pattern == "half":
        weight[: (frames + 1) // 2, 0] = 0.0
    if pattern == "joint":
        weight[:, 0] = 0.0
    if pattern == "nan":
        q[frames // 3 :: 4, 0, 1] = torch.nan
        q[-1, -1] = torch.inf
        return q, None
    if pattern == "odd":
        weight[0, 0], weight[frames // 2, 0], weight[-1, -1] = -1.0, torch.nan, torch.inf
        q[frames // 2, -1] = 0.0
    return q, weight
