"""Linear filters on rotations: Lee and Shin's construction for any mask."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchquat import timeline
from torchquat._checks import check_choice, check_count, check_positive
from torchquat._planes import Vector
from torchquat.filters._bandwidth import (
    Bandwidth,
    default_radius,
    per_joint,
    register_bandwidth,
    shown,
)
from torchquat.filters._lee_shin import move
from torchquat.filters._masks import as_mask, check_mask, convolve, masked_mean
from torchquat.timeline import BOUNDARIES, Boundary

__all__ = ["GaussianFilter", "LinearFilter", "gaussian_filter", "linear_filter"]


def linear_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    mask: Tensor | Sequence[float],
    boundary: Boundary = "reflect",
    causal: bool = False,
) -> Tensor:
    r"""Convolve a sequence of rotations with a mask.

    .. math::
        \hat q_i = q_i \exp\Big(\sum_{j=-k}^{k} m_j (c_{i+j} - c_i)\Big), \quad
        c_{i+1} = c_i + \log(q_i^{-1} q_{i+1})

    Confidences multiply the mask, which is then normalised again: positive and negative entries
    apart, so that no pattern of missing frames raises the gain above that of the mask.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        mask: Coefficients ``m_{-k}, ..., m_k``; ``m_j`` multiplies frame ``i + j``. Divided by
            their sum. A tensor ``(2k + 1, J)`` has one mask per joint.
        boundary: Rule at both ends of the sequence.
        causal: Leave out the later half of the mask, and fill missing frames without looking
            ahead.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or boundary name is invalid, or ``mask`` has an even length, is not
            finite, or does not sum to a positive value.

    Reference:
        Lee and Shin, "General Construction of Time-Domain Filters for Orientation Data", IEEE TVCG
        2002; Courty, EUSIPCO 2008, eq. 2-3. The print of the latter lost a sign: the coefficient of
        an earlier increment is ``b_r = -sum_{j <= r} m_j``, ``r < 0``. Summing ``m_j (c_j - c_i)``
        is the same step.
    """
    unit, confidence = timeline.prepare(q, weight, causal=causal)
    mask = as_mask(mask, unit)
    if causal:
        mask = torch.cat([mask[: len(mask) // 2 + 1], torch.zeros_like(mask[: len(mask) // 2])])
    check_mask(mask)
    mask = mask / mask.sum(0)

    boundary = timeline.past_boundary(boundary, causal)
    return convolve(unit, confidence, mask, boundary=boundary, causal=causal).to(q.dtype)


def gaussian_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    sigma_t: Bandwidth,
    radius: int | None = None,
    boundary: Boundary = "reflect",
    causal: bool = False,
) -> Tensor:
    r"""Convolve a sequence of rotations with a Gaussian: :func:`linear_filter`, ``m_j > 0``.

    .. math:: m_j \propto \exp(-j^2 / 2\sigma_t^2)

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        sigma_t: Temporal standard deviation [frames], > 0; one value or one per joint.
        radius: Half-width of the window [frames], >= 0; ``None``: ``ceil(3 sigma_t)``.
        boundary: Rule at both ends of the sequence.
        causal: Use the window ``i - radius .. i`` only.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range or boundary name is invalid.

    Reference:
        Lee and Shin, IEEE TVCG 2002; the comparison filter of Courty, EUSIPCO 2008, Fig. 2b.
    """
    check_positive("sigma_t", sigma_t)
    radius = default_radius(sigma_t) if radius is None else radius
    check_count("radius", radius, 0)
    unit, confidence = timeline.prepare(q, weight, causal=causal)
    half = torch.arange(radius + 1, dtype=unit.dtype, device=unit.device)[:, None]
    half = torch.exp(-0.5 * (half / per_joint("sigma_t", sigma_t, unit)).square())
    mask = torch.cat([half.flip(0), half[1:]])
    boundary = timeline.past_boundary(boundary, causal)

    def step(window: Tensor, trust: Tensor | None, mask: Tensor) -> Vector:
        return masked_mean(window, trust, mask, causal=causal)[0]

    result = move(unit, confidence, step, radius=radius, boundary=boundary, shared=(mask,))
    return result.to(q.dtype)


class LinearFilter(nn.Module):
    """Module form of :func:`linear_filter`; arguments as there.

    A mask whose later half is zero is causal: it then fills missing frames without looking ahead.

    Raises:
        TypeError: If ``mask`` does not hold numbers.
        ValueError: If ``mask`` has an even length, is not finite, or does not sum to a positive
            value, or ``boundary`` is not a known name.
    """

    mask: Tensor

    def __init__(self, mask: Sequence[float] | Tensor, *, boundary: Boundary = "reflect") -> None:
        super().__init__()
        check_choice("boundary", boundary, BOUNDARIES)
        values = torch.as_tensor(mask, dtype=torch.float64).detach().float()
        check_mask(as_mask(values, values))
        self.register_buffer("mask", values)
        self.boundary: Boundary = boundary
        self.causal = False
        _look_ahead(self)
        self.register_load_state_dict_post_hook(_look_ahead)

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return linear_filter(q, weight, mask=self.mask, boundary=self.boundary, causal=self.causal)

    def extra_repr(self) -> str:
        """Mask and boundary."""
        return f"mask={self.mask.tolist()}, boundary={self.boundary!r}"


def _look_ahead(module: LinearFilter, *_: object) -> None:
    """Whether the mask does, which another that is loaded may."""
    later = module.mask[len(module.mask) // 2 + 1 :]
    module.causal = len(module.mask) > 1 and not bool(later.any())


class GaussianFilter(nn.Module):
    """Module form of :func:`gaussian_filter`; arguments as there.

    The bandwidth is stored as its logarithm: an optimiser step keeps it positive, and ``.to()`` and
    ``state_dict()`` include it whether or not it is ``learnable``. The radius does not follow it.
    """

    log_sigma_t: Tensor

    def __init__(
        self,
        sigma_t: float | Sequence[float] = 1.0,
        *,
        radius: int | None = None,
        boundary: Boundary = "reflect",
        causal: bool = False,
        learnable: bool = False,
    ) -> None:
        super().__init__()
        check_choice("boundary", boundary, BOUNDARIES)
        register_bandwidth(self, "sigma_t", sigma_t, learnable)
        self.radius = default_radius(sigma_t) if radius is None else radius
        check_count("radius", self.radius, 0)
        self.boundary: Boundary = boundary
        self.causal = causal

    @property
    def sigma_t(self) -> Tensor:
        """Temporal standard deviation [frames], ``()`` or ``(J,)``."""
        return self.log_sigma_t.exp()

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return gaussian_filter(
            q,
            weight,
            sigma_t=self.sigma_t,
            radius=self.radius,
            boundary=self.boundary,
            causal=self.causal,
        )

    def extra_repr(self) -> str:
        """Bandwidth, window and boundary."""
        return (
            f"sigma_t={shown(self.sigma_t)}, radius={self.radius}, "
            f"boundary={self.boundary!r}, causal={self.causal}"
        )
