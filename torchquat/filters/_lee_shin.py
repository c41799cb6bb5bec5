"""Lee and Shin's construction: a weighted mean of neighbours along the path of increments."""

from collections.abc import Callable, Iterable
from functools import partial

import torch
from torch import Tensor

from torchquat import _operations, _planes, timeline
from torchquat._blocks import Window, in_windows
from torchquat._eager import derivatives, lowest, visible
from torchquat._operations import accumulated
from torchquat._planes import Quaternion, Vector
from torchquat._pull_back import Planes, run
from torchquat.filters._lee_shin_back import symmetric_back
from torchquat.filters._lee_shin_plain import plain_mean
from torchquat.timeline import Boundary

__all__ = ["Step", "Weigh", "divided", "move", "tangent_mean"]

Weigh = Callable[[int, Callable[[], Tensor]], tuple[float | Tensor, float | Tensor]]
"""``weigh(lag, squared_angle)`` for all pairs of frames ``lag`` apart: the weight of the second
seen from the first, and of the first seen from the second. Each is a number, one per joint ``(J,)``
or one per pair ``(..., P, J)``; ``squared_angle()`` gives those between both ``(..., P, J)``."""

Step = Callable[..., Vector]
"""From a window's frames, components ``(4, ..., T + 2 radius, J)``, their weights (``None``: 1) and
what all windows share to the rotation vectors ``(..., T, J)`` [rad] that move the frames inside."""


def move(
    q: Tensor,
    confidence: Tensor | None,
    step: Step,
    *,
    radius: int,
    boundary: Boundary,
    shared: Iterable[object] = (),
) -> Tensor:
    """Turn every frame by what its window says, in blocks that fit a cache.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        confidence: Weights ``(..., T, J)``; ``None``: 1.
        step: See :data:`Step`.
        radius: Half-width of the window [frames].
        boundary: Rule at both ends.
        shared: What else ``step`` reads; tensors among it get their gradients.

    Returns:
        Unit quaternions ``(..., T, J, 4)``, each in the hemisphere of its input.
    """

    def moved(window: Window) -> Quaternion:
        centre = window.q.narrow(-2, radius, window.frames)
        return _operations.turned(
            _planes.components(centre), step(window.q, window.trust, *window.shared)
        )

    return in_windows(moved, *timeline.pad(q, confidence, radius, boundary), radius, shared)


def tangent_mean(
    q: Tensor,
    trust: Tensor | None,
    weigh: Weigh,
    *,
    centre: float | Tensor,
    radius: int,
    causal: bool,
    fixed: bool,
    rate: float | Tensor | None,
) -> tuple[Vector, Tensor]:
    r"""Mean of ``c_j - c_i`` over the window, with ``c`` the running sum of the increments.

    .. math::
        \frac{\sum_j m_{ij} (c_j - c_i)}{\sum_j m_{ij}}, \quad
        c_{i+1} = c_i + \log(q_i^{-1} q_{i+1})

    The sums grow outward lag by lag, so rounding does not grow with the length of the sequence,
    and a pair of frames is weighed once for both.

    Args:
        q: Components of unit quaternions ``(4, ..., T + 2 radius, J)``.
        trust: Weights of these frames; ``None``: 1.
        weigh: The weights m before these, see :data:`Weigh`.
        centre: Weight of the frame itself.
        radius: Half-width of the window [frames].
        causal: Leave out the later half of the window.
        fixed: No parameter of the weights wants a gradient: fewer steps where nothing else does.
        rate: Where both weights of a pair are the same, and a number times ``exp(rate d^2)``: the
            rate, 0 for a number alone. With it and ``fixed`` the backward pass takes fewer steps.

    Returns:
        Means ``(..., T, J)`` [rad], 0 where the window is empty, and the sums of the weights.
    """
    q = _planes.align_path(q)
    formula = partial(_tangent_mean, weigh, centre, radius, causal, fixed, trust)
    if not fixed or rate is None or trust is not None or causal or radius == 0:
        x, y, z, total = formula(q)
    else:
        x, y, z, total = run(formula, partial(symmetric_back, weigh, rate, radius), q, keep=True)
    return (x, y, z), total


def _tangent_mean(
    weigh: Weigh,
    centre: float | Tensor,
    radius: int,
    causal: bool,
    fixed: bool,
    trust: Tensor | None,
    whole: Tensor,
) -> Planes:
    """:func:`tangent_mean` of frames of one hemisphere."""
    known = (whole, trust, centre)
    if fixed and visible(whole) and not derivatives(*(x for x in known if isinstance(x, Tensor))):
        weighted, total = plain_mean(weigh, centre, radius, causal, trust, whole)
        mean = divided(weighted.unbind(0), total)
        return *mean, total.expand_as(mean[0])
    q = _planes.components(whole)
    frames = q[0].shape[-2] - 2 * radius
    increment = _operations.between(
        *(_planes.cut(q, start, frames + 2 * radius - 1) for start in (0, 1))
    )
    own = torch.ones_like(q[0]) if trust is None else trust
    total = centre * own.narrow(-2, radius, frames)
    weighted = tuple(torch.zeros_like(total) for _ in range(3))
    travelled = increment  # c_{n + lag} - c_n for every pair of frames n, n + lag
    for lag in range(1, radius + 1):
        if lag > 1:
            travelled = _further(travelled, increment, lag)
        # frame i is the second of the pair that starts at i - lag, and the first of its own
        first, pairs = radius - lag, frames + lag
        ahead, behind = weigh(lag, partial(_apart, q, increment, lag, first, pairs))
        sides = ((-1, behind, 0, first), (1, ahead, lag, radius))
        for side, m, row, start in sides[:1] if causal else sides:
            if isinstance(m, float) and m == 0.0:
                continue
            m = _rows(m, row, frames)
            m = m if trust is None else m * trust.narrow(-2, radius + side * lag, frames)
            total = total + m
            weighted = accumulated(weighted, m, _rows_of(travelled, start, frames), side)
    return *divided(weighted, total), total


def _apart(q: Quaternion, increment: Vector, lag: int, first: int, pairs: int) -> Tensor:
    """Squared angles of pairs of frames ``lag`` apart."""
    if lag == 1:  # known already
        step = [component.narrow(-2, first, pairs) for component in increment]
        return _planes.dot(step, step)
    return _operations.squared_angle(
        _planes.cut(q, first, pairs), _planes.cut(q, first + lag, pairs)
    )


def _further(travelled: Vector, increment: Vector, lag: int) -> Vector:
    """One frame further: ``c_{n + lag} - c_n`` from ``c_{n + lag - 1} - c_n``."""
    pairs = travelled[0].shape[-2] - 1
    steps = _rows_of(increment, lag - 1, pairs)
    x, y, z = (c + step for c, step in zip(_rows_of(travelled, 0, pairs), steps, strict=True))
    return x, y, z


def _rows_of(v: Vector, start: int, frames: int) -> Vector:
    x, y, z = (component.narrow(-2, start, frames) for component in v)
    return x, y, z


def _rows(m: float | Tensor, start: int, frames: int) -> float | Tensor:
    """Weights of some pairs; numbers, or one per joint, hold for all."""
    return m.narrow(-2, start, frames) if isinstance(m, Tensor) and m.dim() > 1 else m


def divided(weighted: tuple[Tensor, ...], total: Tensor) -> tuple[Tensor, ...]:
    """The means, 0 where the window is empty."""
    least = torch.finfo(total.dtype).tiny  # the reciprocal of a smaller one is infinite
    if lowest(total) >= least:
        inverse = total.reciprocal()
    else:
        empty = total < least
        inverse = torch.where(empty, 0.0, torch.where(empty, 1.0, total).reciprocal())
    return tuple(inverse * sum_ for sum_ in weighted)
