"""Courty's bilateral orientation filter."""

from __future__ import annotations  # torch 2.6 cannot compile them inside a function

from collections.abc import Callable, Sequence
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from torchquat import missing, so3, timeline
from torchquat._checks import check_choice, check_count, check_positive
from torchquat._eager import derivatives
from torchquat._planes import Vector
from torchquat.filters._bandwidth import (
    Bandwidth,
    default_radius,
    per_joint,
    register_bandwidth,
    shown,
)
from torchquat.filters._lee_shin import move, tangent_mean
from torchquat.timeline import BOUNDARIES, Boundary

__all__ = ["BilateralFilter", "Kernel", "bilateral_filter"]

Kernel = Literal["gaussian", "exponential"]
KERNELS: tuple[str, ...] = get_args(Kernel)


def bilateral_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    sigma_t: Bandwidth,
    sigma_g: Bandwidth,
    radius: int | None = None,
    kernel: Kernel = "gaussian",
    iterations: int = 1,
    boundary: Boundary = "reflect",
    causal: bool = False,
) -> Tensor:
    r"""Move every rotation to the weighted mean of its neighbours, near in time and in angle.

    .. math::
        \hat q_i = q_i \exp\Big(\sum_j m_{ij} (c_j - c_i)\Big), \quad
        m_{ij} \propto
        \exp\Big(-\frac{(i-j)^2}{2\sigma_t^2} - \frac{d(q_i, q_j)^2}{2\sigma_g^2}\Big)

    with :math:`c` the running sum of the increments :math:`\log(q_i^{-1} q_{i+1})` and :math:`d`
    the rotation angle between two frames. The kernel ``"exponential"`` is the paper's print,
    :math:`\exp(-|i-j| / 2\sigma_t^2 - d / 4\sigma_g^2)`: the logarithm there is the quaternion's
    own, half a rotation vector.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        sigma_t: Temporal standard deviation [frames], > 0; one value or one per joint.
        sigma_g: Geodesic standard deviation [rad], > 0; one value or one per joint.
        radius: Half-width of the window [frames], >= 0; 0 changes nothing. ``None``:
            ``ceil(3 sigma_t)``.
        kernel: ``"gaussian"``, or ``"exponential"`` as printed in the paper.
        iterations: How often the filter is applied, >= 0.
        boundary: Rule at both ends of the sequence.
        causal: Use the window ``i - radius .. i`` only.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T J), whatever the radius.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range, kernel or boundary name is invalid.

    Reference:
        Courty, "Bilateral Human Motion Filtering", EUSIPCO 2008, eq. 2-5 and algorithm 1. Departs
        from print in the sign of b_r for r < 0, in normalising over the whole window, and (kernel
        ``"gaussian"``) in squaring both distances, as eq. 4 has them.
    """
    check_positive("sigma_t", sigma_t)
    check_positive("sigma_g", sigma_g)
    check_choice("kernel", kernel, KERNELS)
    check_count("iterations", iterations, 0)
    radius = default_radius(sigma_t) if radius is None else radius
    check_count("radius", radius, 0)
    boundary = timeline.past_boundary(boundary, causal)
    prepared, confidence = timeline.prepare(q, weight, causal=causal)
    weigh = _gaussian if kernel == "gaussian" else _exponential
    sigma_t, sigma_g = (
        per_joint("sigma_t", sigma_t, prepared),
        per_joint("sigma_g", sigma_g, prepared),
    )

    def step(
        window: Tensor, trust: Tensor | None, sigma_t: float | Tensor, sigma_g: float | Tensor
    ) -> Vector:
        def weigh_both(lag: int, squared_angle: Callable[[], Tensor]) -> tuple[Tensor, Tensor]:
            m = weigh(lag, squared_angle(), sigma_t, sigma_g)
            return m, m  # the distance is symmetric

        return tangent_mean(
            window,
            trust,
            weigh_both,
            centre=1.0,
            radius=radius,
            causal=causal,
            fixed=not derivatives(*(s for s in (sigma_t, sigma_g) if isinstance(s, Tensor))),
            rate=-0.5 / sigma_g**2 if kernel == "gaussian" else None,
        )[0]

    unit = prepared
    for iteration in range(iterations):
        if iteration > 0 and confidence is not None:
            # paths across a gap must stay geodesic, as if it were not there
            unit = missing.interpolate(unit, confidence > 0, causal=causal)
        unit = move(
            unit,
            confidence,
            step,
            radius=radius,
            boundary=boundary,
            shared=(sigma_t, sigma_g),
        )
    if iterations > 1:  # each of them kept the hemisphere of the one before
        unit = so3.align(unit, prepared)
    return unit.to(q.dtype)


class BilateralFilter(nn.Module):
    """Module form of :func:`bilateral_filter`; arguments as there.

    Bandwidths are stored as logarithms: an optimiser step keeps them positive, and ``.to()`` and
    ``state_dict()`` include them whether or not they are ``learnable``. The radius does not follow
    them.
    """

    log_sigma_t: Tensor
    log_sigma_g: Tensor

    def __init__(
        self,
        sigma_t: float | Sequence[float] = 1.0,
        sigma_g: float | Sequence[float] = 0.1,
        *,
        radius: int | None = None,
        kernel: Kernel = "gaussian",
        iterations: int = 1,
        boundary: Boundary = "reflect",
        causal: bool = False,
        learnable: bool = False,
    ) -> None:
        super().__init__()
        check_choice("kernel", kernel, KERNELS)
        check_choice("boundary", boundary, BOUNDARIES)
        check_count("iterations", iterations, 0)
        register_bandwidth(self, "sigma_t", sigma_t, learnable)
        register_bandwidth(self, "sigma_g", sigma_g, learnable)
        self.radius = default_radius(sigma_t) if radius is None else radius
        check_count("radius", self.radius, 0)
        self.kernel: Kernel = kernel
        self.iterations = iterations
        self.boundary: Boundary = boundary
        self.causal = causal

    @property
    def sigma_t(self) -> Tensor:
        """Temporal standard deviation [frames], ``()`` or ``(J,)``."""
        return self.log_sigma_t.exp()

    @property
    def sigma_g(self) -> Tensor:
        """Geodesic standard deviation [rad], ``()`` or ``(J,)``."""
        return self.log_sigma_g.exp()

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return bilateral_filter(
            q,
            weight,
            sigma_t=self.sigma_t,
            sigma_g=self.sigma_g,
            radius=self.radius,
            kernel=self.kernel,
            iterations=self.iterations,
            boundary=self.boundary,
            causal=self.causal,
        )

    def extra_repr(self) -> str:
        """Bandwidths, window and options."""
        return (
            f"sigma_t={shown(self.sigma_t)}, sigma_g={shown(self.sigma_g)}, "
            f"radius={self.radius}, kernel={self.kernel!r}, iterations={self.iterations}, "
            f"boundary={self.boundary!r}, causal={self.causal}"
        )


def _gaussian(lag: int, square: Tensor, sigma_t: float | Tensor, sigma_g: float | Tensor) -> Tensor:
    """Weights of pairs ``lag`` frames and so many squared radians apart."""
    return torch.exp(square * (-0.5 / sigma_g**2) - 0.5 * (lag / sigma_t) ** 2)


def _exponential(
    lag: int, square: Tensor, sigma_t: float | Tensor, sigma_g: float | Tensor
) -> Tensor:
    """Weights as printed: unsquared, with the quaternion's own logarithm, half the angle."""
    apart = square > 0
    angle = torch.where(apart, torch.where(apart, square, 1.0).sqrt(), 0.0)
    return torch.exp(angle * (-0.25 / sigma_g**2) - 0.5 * lag / sigma_t**2)
