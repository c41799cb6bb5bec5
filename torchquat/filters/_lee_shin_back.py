r"""Backward pass of Lee and Shin's construction, where both frames of a pair weigh alike.

With the mean :math:`s_i = \sum_j m_{ij} (c_j - c_i) / M_i`, its gradient :math:`g_i` and
:math:`a_i = g_i / M_i`, a pair of frames that are :math:`t = c_j - c_i` apart gets

.. math::
    \partial t = m_{ij} (a_i - a_j), \quad
    \partial m_{ij} = (a_i - a_j) \cdot t - a_i \cdot s_i - a_j \cdot s_j
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchquat import _operations, _planes
from torchquat._planes import Quaternion, Vector
from torchquat._pull_back import Planes
from torchquat._series import squared_angle_and_factor

__all__ = ["symmetric_back"]

Weigh = Callable[[int, Callable[[], Tensor]], tuple[float | Tensor, float | Tensor]]


def symmetric_back(
    weigh: Weigh, rate: float | Tensor, radius: int, planes: Planes, result: Planes, slope: Planes
) -> Planes:
    """Gradients of the frames of a window.

    Args:
        weigh: Weights, as in :mod:`torchquat.filters._lee_shin`; both of a pair are the same.
        rate: They are a number times ``exp(rate d^2)``; 0 for a number alone.
        radius: Half-width of the window [frames].
        planes: Components of the frames ``(4, ..., T + 2 radius, J)``, each in the hemisphere of
            the one before.
        result: The means ``(..., T, J)`` and the sums of the weights.
        slope: The gradients of these.

    Returns:
        Gradients ``(4, ..., T + 2 radius, J)``.
    """
    *mean, total = result
    *by_mean, by_total = slope
    planes = planes[0].unbind(0)
    frames = mean[0].shape[-2]
    inverse = torch.where(total >= torch.finfo(total.dtype).tiny, total, torch.inf).reciprocal()
    shares = [inverse * g for g in by_mean]
    margin = (0, 0, radius, radius)
    common = pad(_planes.dot(shares, mean).sub_(by_total), margin)
    shares = [pad(share, margin) for share in shares]

    ends = _rows(planes, 0, -1), _rows(planes, 1, -1)
    increment = _operations.between(*ends)
    whole = planes[0].new_zeros((4, *planes[0].shape))
    by_frames = whole.unbind(0)
    by_increment = tuple(torch.zeros_like(step) for step in increment)
    # gradient of the paths that start at a frame and are at least so long
    by_path = tuple(step.new_zeros(_rows_shape(step, frames + radius)) for step in increment)
    paths = _paths(increment, radius)
    for lag in range(radius, 0, -1):
        first, pairs = radius - lag, frames + lag
        path = [step.narrow(-2, first, pairs) for step in paths[lag - 1]]
        here, there = ([x.narrow(-2, n, pairs) for x in shares] for n in (first, first + lag))
        apart = [a - b for a, b in zip(here, there, strict=True)]
        by_this_path = [x.narrow(-2, first, pairs) for x in by_path]
        pair = _Pair(planes, path, lag, first, pairs)
        m, _ = weigh(lag, pair.squared_angle)
        if isinstance(m, Tensor) and m.dim() > 1:
            by_square = _planes.dot(apart, path)
            by_square -= common.narrow(-2, first, pairs)
            by_square -= common.narrow(-2, first + lag, pairs)
            pair.pull(by_square.mul_(m).mul_(rate), by_this_path, by_frames)
        for total_, step in zip(by_this_path, apart, strict=True):
            total_ += m * step
        for total_, step in zip(by_increment, by_path, strict=True):
            total_.narrow(-2, lag - 1, frames + radius).add_(step)
    pulled = _operations.between_back((*ends[0], *ends[1]), increment, by_increment)
    for component, total_ in enumerate(by_frames):
        total_.narrow(-2, 0, total_.shape[-2] - 1).add_(pulled[component])
        total_.narrow(-2, 1, total_.shape[-2] - 1).add_(pulled[4 + component])
    return (whole,)


class _Pair:
    """All pairs of frames ``lag`` apart: their squared angles, and the way back from these."""

    def __init__(
        self, planes: Planes, path: list[Tensor], lag: int, first: int, pairs: int
    ) -> None:
        self.planes, self.path = planes, path
        self.lag, self.first, self.pairs = lag, first, pairs

    def squared_angle(self) -> Tensor:
        if self.lag == 1:  # the path is the geodesic
            return _planes.dot(self.path, self.path)
        near, far = (
            tuple(plane.narrow(-2, n, self.pairs) for plane in self.planes)
            for n in (self.first, self.first + self.lag)
        )
        self.sign, self.difference, square = _operations.nearest((*near, *far))
        squared_angle, self.factor = squared_angle_and_factor(0.25 * square)
        return squared_angle

    def pull(self, slope: Tensor, by_path: list[Tensor], by_frames: Planes) -> None:
        """Add what the gradient of the squared angles does to the gradients of paths or frames."""
        if self.lag == 1:
            for total, step in zip(by_path, self.path, strict=True):
                total.addcmul_(slope, step, value=2.0)
            return
        slope = slope.mul_(self.factor).mul_(4.0)
        signed = slope if self.sign is None else self.sign * slope
        for total, step in zip(by_frames, self.difference, strict=True):
            total.narrow(-2, self.first, self.pairs).addcmul_(slope, step, value=-1.0)
            total.narrow(-2, self.first + self.lag, self.pairs).addcmul_(signed, step)


def _paths(increment: Vector, radius: int) -> list[Vector]:
    """``c_{n + lag} - c_n`` for all lags from 1."""
    paths = [increment]
    for lag in range(2, radius + 1):
        rows = paths[-1][0].shape[-2] - 1
        x, y, z = (
            path.narrow(-2, 0, rows) + step.narrow(-2, lag - 1, rows)
            for path, step in zip(paths[-1], increment, strict=True)
        )
        paths.append((x, y, z))
    return paths


def _rows(planes: Planes, start: int, more: int) -> Quaternion:
    x, y, z, w = (plane.narrow(-2, start, plane.shape[-2] + more) for plane in planes)
    return x, y, z, w


def _rows_shape(x: Tensor, rows: int) -> tuple[int, ...]:
    return (*x.shape[:-2], rows, x.shape[-1])
