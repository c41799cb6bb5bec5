"""Kalman's filter on rotations, and the smoother of Rauch, Tung and Striebel."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchquat import missing, so3, timeline
from torchquat._checks import check_positive
from torchquat._running import running_maximum
from torchquat.filters._bandwidth import Bandwidth, per_joint, register_bandwidth, shown
from torchquat.filters._gains import TRANSITION, Entry, Gains, gains

__all__ = ["KalmanSmoother", "kalman_smoother"]

HEAVIEST = 1e18
"""Larger confidences count as this one: their products would overflow."""


def kalman_smoother(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    process_noise: Bandwidth,
    measurement_noise: Bandwidth,
    order: int = 2,
) -> Tensor:
    r"""Track rotation and angular velocity forward, then correct every frame by those after it.

    .. math::
        \text{predict} \quad & \bar R_{i+1} = R_i \exp(\omega_i + \tfrac12 a_i), \quad
        \bar\omega_{i+1} = \omega_i + a_i \\
        \text{update} \quad & v_i = \log(\bar R_i^{-1} q_i), \quad R_i = \bar R_i \exp(k_0 v_i),
        \quad \omega_i = \bar\omega_i + k_1 v_i, \quad \ldots \\
        \text{smooth} \quad & e = \big(\log(\bar R_{i+1}^{-1} \hat R_{i+1}),
        \hat\omega_{i+1} - \bar\omega_{i+1}, \ldots\big), \quad
        \hat R_i = R_i \exp(C_{00} e_0 + C_{01} e_1 + \ldots)

    The errors live in the tangent space of the estimate. Noise is the same along all axes, so the
    gains k and C are those of motion along one axis; they depend on weights only. Only the ratio
    of the two kinds of noise matters. Nothing is assumed about where and how fast a motion starts.

    A confidence divides the variance of its measurement; a missing frame is predicted, and
    corrected by those after it. Before the first and after the last present frame, the estimate
    there is held.

    It is a recursion: Python steps through the frames, all batch items and joints at once, in
    double precision. Known limit: ``torch.compile`` unrolls the steps and compiles for every
    length, and ``torch.export`` fixes the length; ``torch.func`` is free to use.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        process_noise: By how much the highest derivative changes in a frame, standard deviation
            per axis [rad/frame at order 2, rad/frame^2 at order 3], > 0; one value or one per
            joint.
        measurement_noise: Standard deviation per axis of a frame of weight 1 [rad], > 0; one value
            or one per joint.
        order: 2 expects a constant velocity, 3 a constant acceleration :math:`a`.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.

    Reference:
        Kalman 1960; Rauch, Tung and Striebel, AIAA Journal 1965; with errors in the tangent space
        as in Lefferts, Markley and Shuster 1982. A row of Dean, "Non-local Pose Means", Table I.
    """
    check_positive("process_noise", process_noise)
    check_positive("measurement_noise", measurement_noise)
    _check_order(order)
    unit, confidence = timeline.prepare(q, weight)
    if unit.shape[-3] == 0:
        return timeline.restore(unit, unit, q)
    ratio = noise_ratio(process_noise, measurement_noise, unit)
    trusts: Sequence[Entry] = [1.0] * unit.shape[-3]
    if confidence is not None:
        trusts = confidence.double().clamp(max=HEAVIEST).unbind(-2)
    # in double precision: weights of many sizes make gains that magnify rounding
    states = _smoothed(unit.double(), gains(trusts, ratio, order), order)
    result = torch.stack(states, -3).to(unit.dtype)
    if confidence is not None:
        result = _held(result, unit, confidence > 0)
    return timeline.restore(result, unit, q)


class KalmanSmoother(nn.Module):
    """Module form of :func:`kalman_smoother`; arguments as there.

    Both kinds of noise are stored as logarithms: an optimiser step keeps them positive.
    """

    log_process_noise: Tensor
    log_measurement_noise: Tensor

    def __init__(
        self,
        process_noise: float | Sequence[float],
        measurement_noise: float | Sequence[float],
        *,
        order: int = 2,
        learnable: bool = False,
    ) -> None:
        super().__init__()
        _check_order(order)
        register_bandwidth(self, "process_noise", process_noise, learnable)
        register_bandwidth(self, "measurement_noise", measurement_noise, learnable)
        self.order = order

    @property
    def process_noise(self) -> Tensor:
        """Change of the highest derivative in a frame, ``()`` or ``(J,)``."""
        return self.log_process_noise.exp()

    @property
    def measurement_noise(self) -> Tensor:
        """Standard deviation of a measurement [rad], ``()`` or ``(J,)``."""
        return self.log_measurement_noise.exp()

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return kalman_smoother(
            q,
            weight,
            process_noise=self.process_noise,
            measurement_noise=self.measurement_noise,
            order=self.order,
        )

    def extra_repr(self) -> str:
        """Noise and order."""
        return (
            f"process_noise={shown(self.process_noise)}, "
            f"measurement_noise={shown(self.measurement_noise)}, order={self.order}"
        )


class _State(NamedTuple):
    """A rotation ``(..., J, 4)`` and its derivatives ``(..., J, 3)``."""

    rotation: Tensor
    rates: list[Tensor]


def _check_order(order: int) -> None:
    if order not in TRANSITION:
        raise ValueError(f"order must be 2 or 3, got {order!r}.")


def noise_ratio(process_noise: Bandwidth, measurement_noise: Bandwidth, like: Tensor) -> Entry:
    """Variance of the process in units of the measurement's, in double precision."""
    process, measurement = (
        value.double() if isinstance(value, Tensor) else value
        for value in (
            per_joint("process_noise", process_noise, like),
            per_joint("measurement_noise", measurement_noise, like),
        )
    )
    quotient = process / measurement
    return quotient * quotient


def _smoothed(unit: Tensor, gain: Gains, order: int) -> list[Tensor]:
    """Rotations of all frames after both passes."""
    measured = unit.unbind(-3)
    still = torch.zeros_like(measured[0][..., :3])
    expected = _State(measured[0], [still] * (order - 1))
    predicted: list[_State] = []
    filtered: list[_State] = []
    for frame, pull in zip(measured, gain.forward, strict=True):
        if filtered:
            expected = _predicted(filtered[-1])
        predicted.append(expected)
        surprise = so3.between(expected.rotation, frame)
        filtered.append(_moved(expected, [_times(k, surprise) for k in pull]))
    estimate = filtered[-1]
    result = [estimate.rotation]
    for known, ahead, back in zip(
        filtered[-2::-1], predicted[:0:-1], gain.backward[::-1], strict=True
    ):
        error = _difference(ahead, estimate)
        turns = [
            sum(_times(c, e) for c, e in zip(row[1:], error[1:], strict=True))
            + _times(row[0], error[0])
            for row in back
        ]
        estimate = _moved(known, turns)
        result.append(estimate.rotation)
    return result[::-1]


def _predicted(state: _State) -> _State:
    """One frame later, the highest derivative held."""
    velocity, *higher = state.rates
    if not higher:
        return _State(so3.turn(state.rotation, velocity), [velocity])
    (acceleration,) = higher
    turned = so3.turn(state.rotation, velocity + 0.5 * acceleration)
    return _State(turned, [velocity + acceleration, acceleration])


def _moved(state: _State, errors: list[Tensor]) -> _State:
    """The state with errors of rotation and rates put right."""
    turn, *changes = errors
    rates = [rate + change for rate, change in zip(state.rates, changes, strict=True)]
    return _State(so3.turn(state.rotation, turn), rates)


def _difference(of: _State, to: _State) -> list[Tensor]:
    """What must be put right in one state to make it the other."""
    turn = so3.between(of.rotation, to.rotation)
    return [turn, *(b - a for a, b in zip(of.rates, to.rates, strict=True))]


def _times(gain: Entry, v: Tensor) -> Tensor:
    """Vectors ``(..., J, 3)`` times a number, or one for each, in their precision."""
    return gain[..., None].to(v.dtype) * v if isinstance(gain, Tensor) and gain.dim() else gain * v


def _held(result: Tensor, unit: Tensor, present: Tensor) -> Tensor:
    """The result, held before the first and after the last present frame."""
    seen = present.to(torch.uint8)
    since, until = running_maximum(seen, -2), running_maximum(seen.flip(-2), -2).flip(-2)
    held = missing.interpolate(result, (since > 0) & (until > 0))
    # a joint that is missing throughout keeps what it came with
    return torch.where(present.any(-2, keepdim=True)[..., None], held, unit)
