"""Lee and Shin's construction: a weighted mean of neighbours along the path of increments."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchquat import _planes, timeline
from torchquat._blocks import Window, in_windows
from torchquat._eager import derivatives, lowest
from torchquat._planes import Quaternion, Vector
from torchquat.timeline import Boundary

__all__ = ["Step", "Weigh", "add", "divided", "move", "tangent_mean"]

Weigh = Callable[[int, Quaternion, Quaternion], tuple[float | Tensor, float | Tensor]]
"""``weigh(lag, first, second)`` for all pairs of frames ``lag`` apart: the weight of the second
seen from the first, and of the first seen from the second. Each is a number, one per joint ``(J,)``
or one per pair ``(..., P, J)``."""

Step = Callable[[Quaternion, Tensor | None], Vector]
"""From a window's frames ``(..., T + 2 radius, J)``, components and weights (``None``: 1), to the
rotation vectors ``(..., T, J)`` [rad] by which the frames inside are moved."""


def move(
    q: Tensor, confidence: Tensor | None, step: Step, *, radius: int, boundary: Boundary
) -> Tensor:
    """Turn every frame by what its window says, in blocks that fit a cache.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        confidence: Weights ``(..., T, J)``; ``None``: 1.
        step: See :data:`Step`.
        radius: Half-width of the window [frames].
        boundary: Rule at both ends.

    Returns:
        Unit quaternions ``(..., T, J, 4)``, each in the hemisphere of its input.
    """

    def moved(window: Window) -> Quaternion:
        turn = _planes.upper(_planes.exp(step(window.q, window.trust)))
        return _planes.compose(_planes.cut(window.q, radius, window.frames), turn)

    return in_windows(moved, *timeline.pad(q, confidence, radius, boundary), radius)


def tangent_mean(
    q: Quaternion,
    trust: Tensor | None,
    weigh: Weigh,
    *,
    centre: float | Tensor = 1.0,
    radius: int,
    causal: bool = False,
) -> tuple[Vector, Tensor]:
    r"""Mean of ``c_j - c_i`` over the window, with ``c`` the running sum of the increments.

    .. math::
        \frac{\sum_j m_{ij} (c_j - c_i)}{\sum_j m_{ij}}, \quad
        c_{i+1} = c_i + \log(q_i^{-1} q_{i+1})

    The sums grow outward lag by lag, so rounding does not grow with the length of the sequence,
    and a pair of frames is weighed once for both.

    Args:
        q: Components of unit quaternions ``(..., T + 2 radius, J)``.
        trust: Weights of these frames; ``None``: 1.
        weigh: The weights m before these, see :data:`Weigh`.
        centre: Weight of the frame itself.
        radius: Half-width of the window [frames].
        causal: Leave out the later half of the window.

    Returns:
        Means ``(..., T, J)`` [rad], 0 where the window is empty, and the sums of the weights.
    """
    q = _planes.align_path(q)
    frames = q[0].shape[-2] - 2 * radius
    increment = _planes.between(
        *(_planes.cut(q, start, frames + 2 * radius - 1) for start in (0, 1))
    )
    own = torch.ones_like(q[0]) if trust is None else trust
    total = centre * own.narrow(-2, radius, frames)
    weighted = [torch.zeros_like(total) for _ in range(3)]
    travelled = increment  # c_{n + lag} - c_n for every pair of frames n, n + lag
    for lag in range(1, radius + 1):
        if lag > 1:
            travelled = [_further(t, c, lag) for t, c in zip(travelled, increment, strict=True)]
        # frame i is the second of the pair that starts at i - lag, and the first of its own
        pairs = frames + lag
        first = radius - lag
        ahead, behind = weigh(lag, _planes.cut(q, first, pairs), _planes.cut(q, radius, pairs))
        m = _rows(behind, 0, frames)
        m = m if trust is None else m * trust.narrow(-2, first, frames)
        total = total + m
        weighted = [
            add(sum_, m, t.narrow(-2, first, frames), -1)
            for sum_, t in zip(weighted, travelled, strict=True)
        ]
        if not causal:
            m = _rows(ahead, lag, frames)
            m = m if trust is None else m * trust.narrow(-2, radius + lag, frames)
            total = total + m
            weighted = [
                add(sum_, m, t.narrow(-2, radius, frames), 1)
                for sum_, t in zip(weighted, travelled, strict=True)
            ]
    return divided(weighted, total), total


def _further(travelled: Tensor, increment: Tensor, lag: int) -> Tensor:
    """One frame further: ``c_{n + lag} - c_n`` from ``c_{n + lag - 1} - c_n``."""
    pairs = travelled.shape[-2] - 1
    return travelled.narrow(-2, 0, pairs) + increment.narrow(-2, lag - 1, pairs)


def _rows(m: float | Tensor, start: int, frames: int) -> float | Tensor:
    """Weights of some pairs; numbers, or one per joint, hold for all."""
    return m.narrow(-2, start, frames) if isinstance(m, Tensor) and m.dim() > 1 else m


def add(total: Tensor, m: float | Tensor, x: Tensor, sign: int) -> Tensor:
    """``total + sign m x``, in place where no derivative needs it."""
    place = None if derivatives(total, x) or (isinstance(m, Tensor) and derivatives(m)) else total
    if not isinstance(m, Tensor):
        return torch.add(total, x, alpha=sign * m, out=place)
    return torch.addcmul(total, m, x, value=sign, out=place)


def divided(weighted: list[Tensor], total: Tensor) -> Vector:
    """The means, 0 where the window is empty."""
    if lowest(total) > 0:
        inverse = total.reciprocal()
    else:
        empty = total <= 0
        inverse = torch.where(empty, 0.0, torch.where(empty, 1.0, total).reciprocal())
    x, y, z = (inverse * sum_ for sum_ in weighted)
    return x, y, z
