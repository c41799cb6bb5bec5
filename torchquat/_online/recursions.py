"""Filters that carry an estimate from frame to frame: memory of one size, time of one length."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchquat._online import rotations
from torchquat._online.frames import Entered
from torchquat.filters._gains import DIFFUSE, PROCESS, TRANSITION
from torchquat.filters.one_euro import HEAVIEST

__all__ = ["EuroMemory", "KalmanMemory", "OneEuro", "Tracker"]


@dataclass
class EuroMemory:
    """What the One-Euro filter knows of P people, in double precision.

    Attributes:
        estimate: The last result ``(4, P, J)``.
        velocity: Smoothed angular velocity ``(3, P, J)`` [rad/s].
        passed: Frames since the last present one ``(P, J)``.
        seen: Whether there was one ``(P, J)``.
    """

    estimate: Tensor
    velocity: Tensor
    passed: Tensor
    seen: Tensor

    def forgotten(self, people: Tensor) -> "EuroMemory":
        """The same, but nothing of these people, booleans ``(P,)``, was ever seen."""
        return replace(self, seen=self.seen & ~people[:, None])


class OneEuro:
    """:func:`torchquat.one_euro_filter`, one frame further; cut-offs in radians per frame."""

    def __init__(self, min_cutoff: float, beta: float, d_cutoff: float, frame_rate: float) -> None:
        per_frame = 2.0 * math.pi / frame_rate
        self.slowest, self.opening = per_frame * min_cutoff, per_frame * beta
        self.d_cutoff, self.frame_rate = per_frame * d_cutoff, frame_rate
        self.doubt()

    def doubt(self) -> None:
        """Take it no longer for granted that everybody was seen."""
        self._whole = False  # so was the last frame, and all joints are seen

    def begin(self, frame: Entered) -> EuroMemory:
        """Nothing is seen yet."""
        q = frame.unit.double()
        return EuroMemory(q, torch.zeros_like(q[:3]), torch.ones_like(q[0]), q[0] > torch.inf)

    def step(
        self, memory: EuroMemory, frame: Entered, age: Tensor | None
    ) -> tuple[EuroMemory, Tensor]:
        """Take a frame in; the result ``(4, P, J)``."""
        estimate, velocity, passed = memory.estimate, memory.velocity, memory.passed
        if not self._whole:
            estimate = torch.where(memory.seen, estimate, frame.unit)
            velocity = torch.where(memory.seen, velocity, 0.0)
        step = rotations.between(estimate, frame.near(estimate))
        trust = passed if frame.trust is None else passed * _bounded(frame.trust)
        rate = self.d_cutoff * trust
        pull = rate / (rate + 1.0)
        velocity = torch.lerp(velocity, step * (self.frame_rate / passed), pull)
        speed = rotations.squared_norm(velocity).sqrt_()
        rate = (speed * self.opening).add_(self.slowest).mul_(trust)
        estimate = rotations.turn(estimate, rate / (rate + 1.0) * step)

        seen = memory.seen
        if not (frame.whole and self._whole):
            present = _present(frame)
            passed, seen = torch.where(present, 1.0, passed + 1.0), seen | present
        self._whole = frame.whole
        return EuroMemory(estimate, velocity, passed, seen), estimate


@dataclass
class KalmanMemory:
    """What the Kalman filter knows of P people, in double precision.

    Attributes:
        rotation: Estimate ``(4, P, J)``.
        rates: Its derivatives ``(order - 1, 3, P, J)``.
        covariance: Of rotation and derivatives along one axis ``(P, J, order, order)``, in units
            of the measurement's variance.
        held: The estimate at the last present frame ``(4, P, J)``.
        seen: Whether there was one ``(P, J)``.
    """

    rotation: Tensor
    rates: Tensor
    covariance: Tensor
    held: Tensor
    seen: Tensor

    def forgotten(self, people: Tensor) -> "KalmanMemory":
        """The same, but nothing of these people, booleans ``(P,)``, was ever seen."""
        return replace(self, seen=self.seen & ~people[:, None])


class Tracker:
    """The forward pass of :func:`torchquat.kalman_smoother`, one frame further."""

    def __init__(self, ratio: float | Tensor, order: int, like: Tensor) -> None:
        wide = {"dtype": torch.float64, "device": like.device}
        ratio = torch.as_tensor(ratio, **wide)[..., None, None]
        self.transition = torch.tensor(TRANSITION[order], **wide)
        self.process = ratio * torch.tensor(PROCESS[order], **wide)
        self.start = DIFFUSE * (1.0 + ratio) * torch.eye(order, **wide)
        place = torch.arange(order, device=like.device)
        self.edge = (place == 0) | (place == 0)[:, None]
        taylor = [1.0 / math.factorial(k) for k in range(1, order)]
        self.taylor = torch.tensor(taylor, **wide)[:, None, None, None]
        self.doubt()

    def doubt(self) -> None:
        """Take it no longer for granted that everybody was seen."""
        self._whole = False  # so was the last frame, and all joints are seen

    def begin(self, frame: Entered) -> KalmanMemory:
        """Nothing is seen yet."""
        q = frame.unit.double()
        rates = q.new_zeros((len(self.taylor), 3, *q.shape[1:]))
        covariance = self.start.expand(*q.shape[1:], *self.edge.shape)
        return KalmanMemory(q, rates, covariance, q, q[0] > torch.inf)

    def step(
        self, memory: KalmanMemory, frame: Entered, age: Tensor | None
    ) -> tuple[KalmanMemory, Tensor]:
        """Take a frame in; the result ``(4, P, J)``, held where the frame is missing."""
        expected = rotations.turn(memory.rotation, (self.taylor * memory.rates).sum(0))
        rates, seen = self._later(memory.rates), memory.seen
        covariance = self.transition @ memory.covariance @ self.transition.mT + self.process
        if not self._whole:
            expected = torch.where(seen, expected, frame.unit)
            rates = torch.where(seen, rates, 0.0)
            covariance = torch.where(seen[..., None, None], covariance, self.start)

        trust = None if frame.trust is None else _bounded(frame.trust)
        gain, covariance = self._informed(covariance, trust)
        surprise = rotations.between(expected, frame.near(expected))
        rotation = rotations.turn(expected, gain[0] * surprise)
        rates = torch.addcmul(rates, gain[1:, None], surprise)
        held = rotation
        if not (frame.whole and self._whole):
            present = _present(frame)
            held = torch.where(present | ~seen, rotation, memory.held)
            seen = seen | present
        self._whole = frame.whole
        return KalmanMemory(rotation, rates, covariance, held, seen), held

    def _later(self, rates: Tensor) -> Tensor:
        """Rates one frame later, the highest held."""
        if len(rates) == 1:
            return rates
        return torch.stack([rates[0] + rates[1], rates[1]])

    def _informed(self, p: Tensor, trust: Tensor | None) -> tuple[Tensor, Tensor]:
        """Gains ``(order, P, J)``, and the covariance after a measurement of the rotation."""
        known = p[..., :1, :] if trust is None else trust[..., None, None] * p[..., :1, :]
        total = known[..., :1] + 1.0
        left = torch.addcmul(p, p[..., :, :1] / total, known, value=-1.0)
        # on the edge the same number without a difference
        return (known / total)[..., 0, :].movedim(-1, 0), torch.where(self.edge, p / total, left)


def _bounded(trust: Tensor) -> Tensor:
    """Weights in double precision, none so large that products overflow."""
    return trust.double().clamp(max=HEAVIEST)


def _present(frame: Entered) -> Tensor:
    return torch.ones_like(frame.scale) > 0 if frame.trust is None else frame.trust > 0
