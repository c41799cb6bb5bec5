"""Medians of rotations along time: filters that a few wild samples cannot pull."""

import torch
from torch import Tensor, nn

from torchquat import _operations, _planes, missing, timeline
from torchquat._blocks import Window, in_windows
from torchquat._checks import check_choice, check_count, check_positive
from torchquat._operations import accumulated
from torchquat._planes import Quaternion
from torchquat.filters._lee_shin import divided
from torchquat.timeline import BOUNDARIES, Boundary

__all__ = ["HampelFilter", "MedianFilter", "hampel_filter", "median_filter"]

ROUNDING = 1e-3
"""Distances that are rounded off, root of the squared sum [rad]."""

PER_AXIS = 1.0 / 1.5381722544550522
"""Standard deviation per axis over the median distance, for Gaussian noise in three dimensions."""


def median_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    radius: int,
    iterations: int = 10,
    boundary: Boundary = "reflect",
) -> Tensor:
    r"""Move every rotation to the geodesic median of its window.

    .. math::
        \hat q_i = \arg\min_p \sum_{|j - i| \le k} w_j \sqrt{d(p, q_j)^2 + \varepsilon^2}

    by Weiszfeld's iteration in the tangent space of the estimate,
    :math:`p \leftarrow p \exp\big(\sum_j m_j \log(p^{-1} q_j) / \sum_j m_j\big)` with
    :math:`m_j = w_j / \sqrt{d(p, q_j)^2 + \varepsilon^2}`, from the mean on. Rounding by
    :math:`\varepsilon` = 0.001 rad keeps it from sticking to a sample that it meets, and gradients
    finite there.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        radius: Half-width k of the window [frames], >= 0; 0 changes nothing.
        iterations: How often the mean is reweighted, >= 0; 0 gives the mean of the window.
        boundary: Rule at both ends of the sequence.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T J), whatever the radius.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range or boundary name is invalid.

    Reference:
        Weiszfeld, Tohoku Mathematical Journal 1937; Fletcher, Venkatasubramanian and Joshi, "The
        Geometric Median on Riemannian Manifolds", NeuroImage 2009.
    """
    _check(radius, iterations, boundary)
    unit, confidence = timeline.prepare(q, weight)

    def moved(window: Window) -> Quaternion:
        return _median(window, radius, iterations)

    padded = timeline.pad(unit, confidence, radius, boundary)
    return timeline.restore(in_windows(moved, *padded, radius), unit, q)


def hampel_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    radius: int,
    n_sigmas: float = 3.0,
    iterations: int = 10,
    boundary: Boundary = "reflect",
) -> Tensor:
    r"""Replace what stands out of its window by the window's median, and keep the rest.

    .. math::
        \hat q_i = \begin{cases} p_i & d(p_i, q_i) > n s_i \\ q_i & \text{otherwise} \end{cases},
        \quad s_i = 0.6501 \operatorname{median}_{|j - i| \le k} d(p_i, q_j)

    with :math:`p_i` the geodesic median of :func:`median_filter`. In one dimension the factor would
    be 1.4826, one over the median of the absolute value of a standard normal number. A distance
    between rotations is the length of a vector of three of them, its median 1.5382: ``s`` estimates
    the standard deviation per axis, the ``sigma`` of :func:`torchquat.noise.gaussian`.

    Confidences weigh votes in both medians. Missing frames are filled again along the geodesic
    between their neighbours once these are clean. Which frames are replaced does not change
    smoothly: gradients are those of what stands in the result.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        radius: Half-width k of the window [frames], >= 0; 0 changes nothing.
        n_sigmas: How many standard deviations n a frame may be off, > 0. Pure Gaussian noise
            exceeds 3 in 3 % of all frames, 4 in 0.1 %.
        iterations: As in :func:`median_filter`.
        boundary: Rule at both ends of the sequence.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T J) for long sequences; windows are
        compared in blocks.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range or boundary name is invalid.

    Reference:
        Hampel, Journal of the American Statistical Association 1974; Pearson, IEEE Transactions on
        Control Systems Technology 2002.
    """
    _check(radius, iterations, boundary)
    check_positive("n_sigmas", n_sigmas)
    unit, confidence = timeline.prepare(q, weight)

    def moved(window: Window) -> Quaternion:
        centre = _planes.cut(_planes.components(window.q), radius, window.frames)
        median = _median(window, radius, iterations)
        wild = _wild(window, median, radius, n_sigmas)
        x, y, z, w = (torch.where(wild, m, c) for m, c in zip(median, centre, strict=True))
        return x, y, z, w

    padded = timeline.pad(unit, confidence, radius, boundary)
    result = in_windows(moved, *padded, radius)
    if confidence is not None:
        result = missing.interpolate(result, confidence > 0)
    return timeline.restore(result, unit, q)


class MedianFilter(nn.Module):
    """Module form of :func:`median_filter`; arguments as there."""

    def __init__(
        self, radius: int, *, iterations: int = 10, boundary: Boundary = "reflect"
    ) -> None:
        super().__init__()
        _check(radius, iterations, boundary)
        self.radius = radius
        self.iterations = iterations
        self.boundary: Boundary = boundary

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return median_filter(
            q, weight, radius=self.radius, iterations=self.iterations, boundary=self.boundary
        )

    def extra_repr(self) -> str:
        """Window and boundary."""
        return f"radius={self.radius}, iterations={self.iterations}, boundary={self.boundary!r}"


class HampelFilter(nn.Module):
    """Module form of :func:`hampel_filter`; arguments as there."""

    def __init__(
        self,
        radius: int,
        n_sigmas: float = 3.0,
        *,
        iterations: int = 10,
        boundary: Boundary = "reflect",
    ) -> None:
        super().__init__()
        _check(radius, iterations, boundary)
        check_positive("n_sigmas", n_sigmas)
        self.radius = radius
        self.n_sigmas = n_sigmas
        self.iterations = iterations
        self.boundary: Boundary = boundary

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return hampel_filter(
            q,
            weight,
            radius=self.radius,
            n_sigmas=self.n_sigmas,
            iterations=self.iterations,
            boundary=self.boundary,
        )

    def extra_repr(self) -> str:
        """Window, bound and boundary."""
        return (
            f"radius={self.radius}, n_sigmas={self.n_sigmas}, iterations={self.iterations}, "
            f"boundary={self.boundary!r}"
        )


def _check(radius: int, iterations: int, boundary: Boundary) -> None:
    check_count("radius", radius, 0)
    check_count("iterations", iterations, 0)
    check_choice("boundary", boundary, BOUNDARIES)


def _median(window: Window, radius: int, iterations: int) -> Quaternion:
    """Median of every window, the frame itself where nothing in it counts."""
    q = _planes.components(window.q)
    estimate = _planes.cut(q, radius, window.frames)
    for iteration in range(iterations + 1 if radius > 0 else 0):
        total = torch.zeros_like(estimate[0])
        weighted = tuple(torch.zeros_like(total) for _ in range(4))
        for place in range(2 * radius + 1):
            sample = _planes.cut(q, place, window.frames)
            square, factor = _operations.apart(estimate, sample)
            m = (square + ROUNDING**2).rsqrt() if iteration > 0 else torch.ones_like(square)
            if window.trust is not None:
                m = m * window.trust.narrow(-2, place, window.frames)
            total = total + m
            weighted = accumulated(weighted, m * factor, sample)
        # the vector part of a quotient is linear: that of the sum is the sum of the vectors
        x, y, z = _planes.vector_part(estimate, divided(weighted, total))
        estimate = _operations.turned(estimate, (x, y, z))
    return estimate


def _wild(window: Window, median: Quaternion, radius: int, n_sigmas: float) -> Tensor:
    """Which frames are too far from the median of their window."""
    middle = tuple(plane.detach() for plane in median)
    q = _planes.components(window.q.detach())
    squares, trusts = [], []
    for place in range(2 * radius + 1):
        sample = _planes.cut(q, place, window.frames)
        squares.append(_operations.squared_angle(middle, sample))  # pyright: ignore[reportArgumentType]
        known = window.trust
        trusts.append(
            torch.ones_like(squares[-1])
            if known is None
            else known.detach().narrow(-2, place, window.frames)
        )
    typical = weighted_median(torch.stack(squares), torch.stack(trusts))
    return squares[radius] > (n_sigmas * PER_AXIS) ** 2 * typical


def weighted_median(values: Tensor, weights: Tensor) -> Tensor:
    """Lower median over the first axis: half of the weight lies at or below it."""
    ordered, order = values.sort(0)
    reached = weights.gather(0, order).cumsum(0)
    below = (reached < 0.5 * reached[-1:]).sum(0, keepdim=True)
    return ordered.gather(0, below.clamp(max=len(values) - 1))[0]
