"""Lee and Shin's construction where no derivative is asked for: in place, and in fewest steps.

Components are stacked, ``(4, ...)`` or ``(3, ...)``, so that one call serves them all: at a few
thousand frames the calls cost as much as the arithmetic.
"""

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import highest
from torchquat._series import angle_over_half_sine, squared_arcsine

__all__ = ["plain_mean"]

Weigh = Callable[[int, Callable[[], Tensor]], tuple[float | Tensor, float | Tensor]]


def plain_mean(
    weigh: Weigh,
    centre: float | Tensor,
    radius: int,
    causal: bool,
    trust: Tensor | None,
    q: Tensor,
) -> tuple[Tensor, Tensor]:
    """Sums over windows; arguments as in :func:`torchquat.filters._lee_shin.tangent_mean`.

    Returns:
        Weighted sums ``(3, ..., T, J)`` [rad], and the sums of the weights ``(..., T, J)``, or
        one where all frames have the same.
    """
    frames = q.shape[-2] - 2 * radius
    increment = _increments(q)
    own = q.new_ones(()) if trust is None else trust.narrow(-2, radius, frames)
    total = centre * own  # one number as long as all weights are
    weighted = q.new_zeros((3, *q.shape[1:-2], frames, q.shape[-1]))
    travelled = increment  # c_{n + lag} - c_n for every pair of frames n, n + lag
    for lag in range(1, radius + 1):
        if lag > 1:
            pairs = travelled.shape[-2] - 1
            travelled = travelled.narrow(-2, 0, pairs) + increment.narrow(-2, lag - 1, pairs)
        # frame i is the second of the pair that starts at i - lag, and the first of its own
        first, pairs = radius - lag, frames + lag
        ahead, behind = weigh(lag, partial(_squared_angle, q, increment, lag, first, pairs))
        sides = ((-1, behind, 0, first), (1, ahead, lag, radius))
        for side, m, row, start in sides[:1] if causal else sides:
            if isinstance(m, Tensor) and m.dim() > 1:
                m = m.narrow(-2, row, frames)
            if trust is not None:
                m = m * trust.narrow(-2, radius + side * lag, frames)
            total = total + m
            step = travelled.narrow(-2, start, frames)
            if isinstance(m, Tensor):
                weighted.addcmul_(m, step, value=side)
            else:
                weighted.add_(step, alpha=side * m)
    return weighted, total


def _increments(q: Tensor) -> Tensor:
    """Rotation vectors from every frame to the next, ``(3, ..., N - 1, J)``."""
    here, there = (q.narrow(-2, start, q.shape[-2] - 1) for start in (0, 1))
    difference = there - here
    apart = difference.unbind(0)
    factor = angle_over_half_sine(_planes.dot(apart, apart).mul_(0.25))
    step = q.new_empty((3, *difference.shape[1:]))
    for place, component in zip(step, _planes.vector_part(here.unbind(0), apart), strict=True):
        torch.mul(factor, component, out=place)
    return step


def _squared_angle(q: Tensor, increment: Tensor, lag: int, first: int, pairs: int) -> Tensor:
    """Squared angles of pairs of frames ``lag`` apart."""
    if lag == 1:  # known already
        step = increment.narrow(-2, first, pairs).unbind(0)
        return _planes.dot(step, step)
    near, far = (q.narrow(-2, n, pairs) for n in (first, first + lag))
    apart = (far - near).unbind(0)
    square = _planes.dot(apart, apart)
    if not highest(square) <= 2.0:  # of q and -q, the nearer
        apart = (far * _planes.sign_of(2.0 - square) - near).unbind(0)
        square = _planes.dot(apart, apart)
    return squared_arcsine(square.mul_(0.25)).mul_(16.0)
