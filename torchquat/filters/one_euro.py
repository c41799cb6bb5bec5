"""The One-Euro filter on rotations: a low-pass filter that opens as the motion gets faster."""

import math

import torch
from torch import Tensor, nn

from torchquat import _planes, so3, timeline
from torchquat._checks import check_positive

__all__ = ["OneEuroFilter", "one_euro_filter"]

HEAVIEST = 1e18
"""Larger confidences count as this one: their products would overflow."""


def one_euro_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    min_cutoff: float,
    beta: float,
    d_cutoff: float = 1.0,
    frame_rate: float = 1.0,
) -> Tensor:
    r"""Follow a sequence frame by frame, the closer the faster it turns.

    .. math::
        v_i &= \log(\hat q_{i-1}^{-1} q_i), \quad
        \omega_i = \omega_{i-1} + \alpha(f_d) (v_i f - \omega_{i-1}), \\
        \hat q_i &= \hat q_{i-1} \exp\big(\alpha(f_c + \beta |\omega_i|)\, v_i\big), \quad
        \alpha(c) = \frac{2 \pi c / f}{1 + 2 \pi c / f}

    with :math:`f` the frame rate, :math:`\hat q_0 = q_0` and :math:`\omega_0 = 0`. Everything
    happens in the tangent space of the estimate before. A confidence multiplies :math:`2 \pi c / f`
    as if the noise had that much less variance. After a gap, the frames that passed since the last
    present one count as one long frame; the gap itself holds the last estimate.

    The filter is causal, and a recursion: Python steps through the frames, all batch items and
    joints at once, in double precision. Known limit: ``torch.compile`` unrolls the steps and
    compiles for every length, and ``torch.export`` fixes the length; ``torch.func`` is free to use.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        min_cutoff: Cut-off at rest :math:`f_c`, > 0 [Hz; cycles per frame at the default rate].
        beta: How much the cut-off rises with the angular speed, >= 0 [cycles per radian].
        d_cutoff: Cut-off :math:`f_d` for the angular velocity, > 0, in the unit of ``min_cutoff``.
        frame_rate: Frames per second, > 0.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.

    Reference:
        Casiez, Roussel and Vogel, "1 Euro Filter", CHI 2012, algorithm 1, with the difference to
        the estimate before as printed there; ``|omega|`` is one speed for all three axes.
    """
    _check(min_cutoff, beta, d_cutoff, frame_rate)
    unit, confidence = timeline.prepare(q, weight, causal=True)
    if unit.shape[-3] == 0:
        return timeline.restore(unit, unit, q)
    # in double precision: products of thousands of turns drift off the unit sphere
    first, *rest = unit.double().unbind(-3)
    velocity, passed = torch.zeros_like(first[..., :3]), None
    trusts = [None] * len(rest)
    if confidence is not None:
        _, *trusts = confidence.double().clamp(max=HEAVIEST)[..., None].unbind(-3)
        passed = torch.ones_like(first[..., :1])
    # a tensor: numbers are divided in double precision where no weight makes them tensors
    slow = torch.tensor(d_cutoff / frame_rate, dtype=first.dtype, device=first.device)
    estimates = [first]
    for frame, trust in zip(rest, trusts, strict=True):
        step = so3.between(estimates[-1], frame)
        pull = _gain(slow, trust, passed)
        seen = step * frame_rate if passed is None else step * frame_rate / passed
        velocity = velocity + pull * (seen - velocity)
        cutoff = min_cutoff / frame_rate + (beta / frame_rate) * _norm(velocity)
        estimates.append(so3.turn(estimates[-1], _gain(cutoff, trust, passed) * step))
        if trust is not None and passed is not None:
            passed = torch.where(trust > 0, 1.0, passed + 1.0)
    result = torch.stack(estimates, -3).to(unit.dtype)
    if confidence is not None:
        # a joint that is missing throughout keeps what it came with
        result = torch.where((confidence > 0).any(-2, keepdim=True)[..., None], result, unit)
    return timeline.restore(result, unit, q)


class OneEuroFilter(nn.Module):
    """Module form of :func:`one_euro_filter`; arguments as there."""

    def __init__(
        self, min_cutoff: float, beta: float, *, d_cutoff: float = 1.0, frame_rate: float = 1.0
    ) -> None:
        super().__init__()
        _check(min_cutoff, beta, d_cutoff, frame_rate)
        self.min_cutoff = min_cutoff
        self.beta = beta
        self.d_cutoff = d_cutoff
        self.frame_rate = frame_rate

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return one_euro_filter(
            q,
            weight,
            min_cutoff=self.min_cutoff,
            beta=self.beta,
            d_cutoff=self.d_cutoff,
            frame_rate=self.frame_rate,
        )

    def extra_repr(self) -> str:
        """Cut-offs and slope."""
        return (
            f"min_cutoff={self.min_cutoff}, beta={self.beta}, d_cutoff={self.d_cutoff}, "
            f"frame_rate={self.frame_rate}"
        )


def _check(min_cutoff: float, beta: float, d_cutoff: float, frame_rate: float) -> None:
    check_positive("min_cutoff", min_cutoff)
    check_positive("d_cutoff", d_cutoff)
    check_positive("frame_rate", frame_rate)
    if not (math.isfinite(beta) and beta >= 0):
        raise ValueError(f"beta must be finite and >= 0, got {beta}.")


def _gain(cutoff: Tensor, trust: Tensor | None, passed: Tensor | None) -> Tensor:
    """Share of the way to a frame, for a cut-off in cycles per frame."""
    rate = 2.0 * math.pi * cutoff
    if trust is not None and passed is not None:
        # in this order, so that weights of 1 give the bits of no weights
        rate = passed * rate * trust
    return rate / (1.0 + rate)


def _norm(v: Tensor) -> Tensor:
    """Norms ``(..., 1)``; the gradient is 0 at 0."""
    square = _planes.dot(v.unbind(-1), v.unbind(-1))[..., None]
    moving = square > 0
    return torch.where(moving, torch.where(moving, square, 1.0).sqrt(), 0.0)
