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


@dataclass(frozen=True)
class OneEuro:
    """:func:`torchquat.one_euro_filter`, one frame further; frequencies in cycles per frame."""

    min_cutoff: float
    beta: float
    d_cutoff: float
    frame_rate: float

    def doubt(self) -> None:
        """Nothing is remembered beside the memory."""

    def begin(self, frame: Entered) -> EuroMemory:
        """Nothing is seen yet."""
        q = frame.q.double()
        return EuroMemory(q, torch.zeros_like(q[:3]), torch.ones_like(q[0]), q[0] > torch.inf)

    def step(
        self, memory: EuroMemory, frame: Entered, age: Tensor | None
    ) -> tuple[EuroMemory, Tensor]:
        """Take a frame in; the result ``(4, P, J)``."""
        q, trust, present = _measured(frame)
        estimate = torch.where(memory.seen, memory.estimate, q)
        velocity = torch.where(memory.seen, memory.velocity, 0.0)
        step = rotations.between(estimate, rotations.nearer(q, estimate))
        spread = memory.passed * (2.0 * math.pi / self.frame_rate) * trust
        rate = self.d_cutoff * spread
        pull = rate / (rate + 1.0)
        velocity = velocity + pull * (step * (self.frame_rate / memory.passed) - velocity)
        speed = rotations.squared_norm(velocity).sqrt_()
        rate = (self.min_cutoff + self.beta * speed) * spread
        estimate = rotations.turn(estimate, rate / (rate + 1.0) * step)
        passed = torch.where(present, 1.0, memory.passed + 1.0)
        return EuroMemory(estimate, velocity, passed, memory.seen | present), estimate


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

    def doubt(self) -> None:
        """Nothing is remembered beside the memory."""

    def begin(self, frame: Entered) -> KalmanMemory:
        """Nothing is seen yet."""
        q = frame.q.double()
        rates = q.new_zeros((len(self.taylor), 3, *q.shape[1:]))
        covariance = self.start.expand(*q.shape[1:], *self.edge.shape)
        return KalmanMemory(q, rates, covariance, q, q[0] > torch.inf)

    def step(
        self, memory: KalmanMemory, frame: Entered, age: Tensor | None
    ) -> tuple[KalmanMemory, Tensor]:
        """Take a frame in; the result ``(4, P, J)``, held where the frame is missing."""
        q, trust, present = _measured(frame)
        seen = memory.seen
        turned = rotations.turn(memory.rotation, (self.taylor * memory.rates).sum(0))
        expected = torch.where(seen, turned, q)
        rates = torch.where(seen, self._later(memory.rates), 0.0)
        covariance = self.transition @ memory.covariance @ self.transition.mT + self.process
        covariance = torch.where(seen[..., None, None], covariance, self.start)

        share = trust / (1.0 + trust * covariance[..., 0, 0])
        gain = (share[..., None] * covariance[..., 0]).movedim(-1, 0)
        surprise = rotations.between(expected, rotations.nearer(q, expected))
        rotation = rotations.turn(expected, gain[0] * surprise)
        rates = rates + gain[1:, None] * surprise
        covariance = self._seen(covariance, trust, share)
        held = torch.where(present | ~seen, rotation, memory.held)
        return KalmanMemory(rotation, rates, covariance, held, seen | present), held

    def _later(self, rates: Tensor) -> Tensor:
        """Rates one frame later, the highest held."""
        if len(rates) == 1:
            return rates
        return torch.stack([rates[0] + rates[1], rates[1]])

    def _seen(self, p: Tensor, trust: Tensor, share: Tensor) -> Tensor:
        """Covariance after a measurement of the rotation."""
        total = (1.0 + trust * p[..., 0, 0])[..., None, None]
        left = torch.addcmul(p, share[..., None, None] * p[..., :, :1], p[..., :1, :], value=-1.0)
        # on the edge the same number without a difference
        return torch.where(self.edge, p / total, left)


def _measured(frame: Entered) -> tuple[Tensor, Tensor, Tensor]:
    """A frame and its weights in double precision, and where it is present."""
    q = frame.q.double()
    if frame.trust is None:
        trust = torch.ones_like(q[0])
    else:
        trust = frame.trust.double().clamp(max=HEAVIEST)
    return q, trust, trust > 0
