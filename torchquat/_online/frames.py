"""The last frames of a stream: unit length, signs in a row, missing ones filled as far as known."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchquat import missing, so3
from torchquat._eager import visible
from torchquat._online import rotations

__all__ = ["Entered", "Frames", "entered", "first_frames", "pushed", "settled"]


@dataclass
class Frames:
    """The last W frames of P people.

    Attributes:
        q: Unit quaternions ``(4, P, W, J)``, each in the hemisphere of the one before; what is
            missing is filled.
        trust: Their weights ``(P, W, J)``, 0 where missing.
        gap: Frames since the last present one ``(P, J)``.
        seen: Whether there was one ``(P, J)``.
    """

    q: Tensor
    trust: Tensor
    gap: Tensor
    seen: Tensor

    def forgotten(self, people: Tensor) -> "Frames":
        """The same, but nothing of these people, booleans ``(P,)``, was ever seen."""
        seen = self.seen & ~people[:, None]
        return replace(self, gap=torch.where(seen, self.gap, 0.0), seen=seen)


@dataclass
class Entered:
    """One frame on its way in.

    Attributes:
        q: Quaternions ``(4, P, J)`` that ``scale`` makes unit ones.
        scale: One over their norms ``(P, J)``.
        trust: Weights ``(P, J)``; ``None``: all are seen to be 1.
        whole: Whether nothing is seen to be missing.
        directed: Which have a direction; ``None``: all.
    """

    q: Tensor
    scale: Tensor
    trust: Tensor | None
    whole: bool
    directed: Tensor | None = None

    @property
    def unit(self) -> Tensor:
        """Unit quaternions ``(4, P, J)``."""
        return self.scale * self.q

    def near(self, reference: Tensor) -> Tensor:
        """Unit quaternions in the hemisphere of a reference ``(4, P, J)``."""
        return torch.copysign(self.scale, (self.q * reference).sum(0)) * self.q


def entered(frame: Tensor, weight: Tensor | None) -> Entered:
    """Look at a frame ``(P, J, 4)``: its norms, and what is missing in it."""
    planes = frame.movedim(-1, 0)
    if visible(frame):
        square = rotations.squared_norm(planes)
        limits = torch.finfo(frame.dtype)
        # outside, digits of the square are lost; not a number is on neither side
        if _within(square, limits.tiny / limits.eps, limits.max * limits.eps):
            if weight is None:
                return Entered(planes, square.rsqrt(), None, whole=True)
            if _within(weight, *missing.weight_range(frame.dtype)):
                return Entered(planes, square.rsqrt(), weight.to(frame.dtype), whole=True)
    trust = missing.confidence(frame, weight)
    unit = so3.normalize(frame).movedim(-1, 0)
    return Entered(unit, torch.ones_like(unit[0]), trust, False, so3.usable(frame))


def _within(x: Tensor, low: float, high: float) -> bool:
    if x.dtype == torch.bool:
        return bool(x.all())
    least, most = torch.aminmax(x)
    return float(least) > low and float(most) < high


def first_frames(frame: Entered, width: int) -> Frames:
    """As many copies of a first frame; nothing is seen yet."""
    q = frame.unit[..., None, :].expand(-1, -1, width, -1)
    nothing = torch.zeros_like(frame.q[0])
    return Frames(q, torch.ones_like(q[0]), nothing, nothing > 0)


def settled(frames: Frames, frame: Entered) -> Frames:
    """The next frames where this one, and the one before, have all joints."""
    unit = frame.near(frames.q[..., -1, :])
    trust = frames.trust
    if frame.trust is not None:
        trust = torch.cat([trust[:, 1:], frame.trust[:, None]], 1)
    q = torch.cat([frames.q[..., 1:, :], unit[..., None, :]], -2)
    return Frames(q, trust, frames.gap, frames.seen)


def pushed(frames: Frames, frame: Entered, *, causal: bool) -> Frames:
    """The next frames, whatever is missing in this one.

    A missing frame holds the last present one until the next is there. Then all between are filled
    along the geodesic between both, unless ``causal``; those before the first present one hold it.
    """
    trust = torch.ones_like(frame.q[0]) if frame.trust is None else frame.trust
    present = trust > 0
    last = frames.q[..., -1, :]
    unit = torch.where(present | ~frames.seen, frame.near(last), last)
    past = frames.q[..., 1:, :]
    ended = present & ((frames.gap > 0) | ~frames.seen)
    if not visible(ended) or bool(ended.any()):
        gap = torch.zeros_like(frames.gap) if causal else frames.gap
        past = _filled(past, unit, torch.where(present, gap, 0.0))
        past = torch.where((present & ~frames.seen)[:, None], unit[..., None, :], past)
    return Frames(
        torch.cat([past, unit[..., None, :]], -2),
        torch.cat([frames.trust[:, 1:], trust[:, None]], 1),
        torch.where(present, 0.0, frames.gap + 1.0),
        frames.seen | present,
    )


def _filled(past: Tensor, unit: Tensor, gap: Tensor) -> Tensor:
    """Past frames, the last ``gap`` of them on the geodesic that ends in ``unit``."""
    width = past.shape[-2]
    if width == 0:
        return past
    held = past[..., -1:, :]
    ahead = torch.arange(width, 0, -1, dtype=gap.dtype, device=gap.device)[:, None]
    share = ((gap[:, None] + 1.0 - ahead) / (gap[:, None] + 1.0)).clamp(min=0.0)
    filled = rotations.turn(held, share * rotations.between(held, unit[..., None, :]))
    return torch.where(ahead <= gap[:, None], filled, past)
