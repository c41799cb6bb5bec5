"""Windowed filters frame by frame, once or several times over."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from torchquat._eager import visible
from torchquat._online.frames import Entered, Frames, first_frames, pushed, settled
from torchquat._online.windows import Centre

__all__ = ["Cascade", "CascadeMemory", "Windowed"]


@dataclass(frozen=True)
class Windowed:
    """A filter that sees a window only.

    Attributes:
        past: Frames before the filtered one that are read, in each pass.
        future: Frames after it.
        centre: The rule for one window, given a tensor of the dtype and device, ``(..., J, 4)``.
        ends: The filter itself, for frames whose window is not all there.
        causal: Missing frames hold the last present one.
        passes: How often the rule is applied.
        start: In place of ``ends`` at the start.
    """

    past: int
    future: int
    centre: Callable[[Tensor], Centre]
    ends: nn.Module
    causal: bool = False
    passes: int = 1
    start: nn.Module | None = None

    @property
    def latency(self) -> int:
        """Frames between what goes in and what comes out."""
        return self.future * self.passes

    @property
    def width(self) -> int:
        """Frames that a result depends on."""
        return (self.past + self.future) * self.passes + 1

    def machine(self, like: Tensor) -> "Cascade":
        """What takes the frames in, for tensors like ``(..., J, 4)``."""
        return Cascade(self, like)


@dataclass
class CascadeMemory:
    """The last frames before each pass, the first ones as far back as a result depends on."""

    passes: list[Frames]

    def forgotten(self, people: Tensor) -> "CascadeMemory":
        """The same, but nothing of these people, booleans ``(P,)``, was ever seen."""
        return CascadeMemory([frames.forgotten(people) for frames in self.passes])


class Cascade:
    """Pass after pass over the frames of a stream.

    What is seen to be there, so that no weights are needed, is remembered beside the memory: it
    only saves time.
    """

    def __init__(self, windowed: Windowed, like: Tensor) -> None:
        self.windowed = windowed
        self.centre = windowed.centre(like)
        self.doubt()
        self._equal = [0] * windowed.passes

    def doubt(self) -> None:
        """Take it no longer for granted that everybody was seen."""
        self._whole = [False] * self.windowed.passes

    def begin(self, frame: Entered) -> CascadeMemory:
        """Nothing is seen yet."""
        window = self.windowed
        widths = [window.width] + [window.past + window.future + 1] * (window.passes - 1)
        return CascadeMemory([first_frames(frame, width) for width in widths[: window.passes]])

    def step(
        self, memory: CascadeMemory, frame: Entered, age: Tensor | None
    ) -> tuple[CascadeMemory, Tensor]:
        """Take a frame in.

        Args:
            memory: What was there before.
            frame: A frame of all people.
            age: How many frames each has now, ``(P,)``; ``None``: more than a window.

        Returns:
            What is there now, and results ``(4, P, J)`` of ``latency`` frames before, which hold
            for those people whose window is all there.
        """
        window, passes, out = self.windowed, [], frame.q
        if not memory.passes:
            return memory, frame.unit
        for number, before in enumerate(memory.passes):
            if number > 0:
                frame = self._between(passes[-1], out, number, age)
            frames, trust = self._taken(before, frame, number)
            passes.append(frames)
            span = window.past + window.future + 1
            seen = None if trust is None else trust[:, -span:]
            out = self.centre(frames.q[..., -span:, :], seen)
        return CascadeMemory(passes), out

    def _taken(self, before: Frames, frame: Entered, number: int) -> tuple[Frames, Tensor | None]:
        """The next frames, and their weights unless all are seen to be 1."""
        self._equal[number] = self._equal[number] + 1 if frame.trust is None else 0
        if frame.whole and self._whole[number]:
            if frame.trust is None and self._equal[number] <= before.q.shape[-2]:
                frame = replace(frame, trust=torch.ones_like(frame.scale))
            frames = settled(before, frame)
        else:
            frames = pushed(before, frame, causal=self.windowed.causal)
        self._whole[number] = frame.whole
        return frames, None if self._equal[number] >= frames.q.shape[-2] else frames.trust

    def _between(self, frames: Frames, out: Tensor, number: int, age: Tensor | None) -> Entered:
        """What a pass makes of a frame, on its way into the next."""
        future = self.windowed.future
        trust = frames.trust[:, -1 - future]
        if age is not None:  # before there is a first frame, the pass makes up something
            trust = torch.where((age > number * future)[:, None], trust, 0.0)
        whole = visible(trust) and bool(trust.min() > 0)
        return Entered(out, torch.ones_like(trust), trust, whole)
