"""Lee and Shin's construction: a weighted mean of neighbours along the path of increments."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchquat import so3, timeline
from torchquat.timeline import Boundary

__all__ = ["Weigh", "tangent_mean"]

Weigh = Callable[[int, Tensor, Tensor], tuple[Tensor, Tensor]]
"""``weigh(lag, first, second)`` for all pairs of frames ``lag`` apart: the weight of the second
seen from the first, and of the first seen from the second. Each broadcasts to ``(..., J, 1)``."""


def tangent_mean(
    q: Tensor,
    confidence: Tensor,
    weigh: Weigh,
    *,
    centre: float | Tensor = 1.0,
    radius: int,
    boundary: Boundary,
    causal: bool = False,
) -> tuple[Tensor, Tensor]:
    r"""Mean of ``c_j - c_i`` over the window, with ``c`` the running sum of the increments.

    .. math::
        \frac{\sum_j m_{ij} (c_j - c_i)}{\sum_j m_{ij}}, \quad
        c_{i+1} = c_i + \log(q_i^{-1} q_{i+1})

    The sums grow outward lag by lag, so rounding does not grow with the length of the sequence,
    and a pair of frames is weighed once for both.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        confidence: Weights ``(..., T, J, 1)``.
        weigh: The weights m before confidences, see :data:`Weigh`.
        centre: Weight of the frame itself.
        radius: Half-width of the window [frames].
        boundary: Rule at both ends.
        causal: Leave out the later half of the window.

    Returns:
        Means ``(..., T, J, 3)`` [rad], 0 where the window is empty, and the sums of the weights
        ``(..., T, J, 1)``.
    """
    frames = q.shape[-3]
    padded, trust = timeline.pad(q, confidence, radius, boundary)
    increment = so3.log(so3.relative(padded[..., :-1, :, :], padded[..., 1:, :, :]))

    total = centre * confidence
    weighted = torch.zeros_like(q[..., :3])
    travelled = increment  # c_{n + lag} - c_n for every pair
    for lag in range(1, radius + 1):
        if lag > 1:
            travelled = travelled[..., :-1, :, :] + increment[..., lag - 1 :, :, :]
        ahead, behind = weigh(lag, padded[..., :-lag, :, :], padded[..., lag:, :, :])
        # frame i is the second of the pair that starts at i - lag, and the first of its own
        m = (behind * trust[..., :-lag, :, :]).narrow(-3, radius - lag, frames)
        total = total + m
        weighted = weighted - m * travelled.narrow(-3, radius - lag, frames)
        if not causal:
            m = (ahead * trust[..., lag:, :, :]).narrow(-3, radius, frames)
            total = total + m
            weighted = weighted + m * travelled.narrow(-3, radius, frames)
    empty = total <= 0
    return torch.where(empty, 0.0, weighted / torch.where(empty, 1.0, total)), total
