"""A filter fed frame by frame, with a stated latency."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from torchquat._checks import check_frame
from torchquat._online.cascade import Cascade, CascadeMemory, Windowed
from torchquat._online.ends import at_the_end, at_the_start
from torchquat._online.frames import Entered, entered
from torchquat._online.recursions import EuroMemory, KalmanMemory, OneEuro, Tracker
from torchquat._online.rotations import nearer
from torchquat._online.rules import plan

__all__ = ["Stream", "StreamState"]


class Layout(NamedTuple):
    """What all frames of a stream have in common."""

    shape: torch.Size
    dtype: torch.dtype
    device: torch.device

    def __str__(self) -> str:
        return f"{tuple(self.shape)} of {self.dtype} on {self.device}"


@dataclass
class StreamState:
    """All that a stream knows; of P people, however they were laid out.

    Attributes:
        age: Frames since each person's start ``(P,)``, counted up to the width of the window.
        given: The last ``latency + 1`` frames as they came, normalised, ``(4, P, latency + 1, J)``.
        memory: What the filter remembers, tensors too.
        layout: Shape, dtype and device of a frame.
    """

    age: Tensor
    given: Tensor
    memory: CascadeMemory | EuroMemory | KalmanMemory
    layout: Layout


class Stream:
    r"""A filter for frames that come one by one.

    >>> stream = Stream(BilateralFilter(sigma_t=1.0, sigma_g=0.5))
    >>> for frame in frames:  # (..., J, 4)
    ...     smooth = stream.push(frame)  # that of stream.latency frames before; at first None
    >>> rest = stream.flush()  # (..., latency, J, 4)

    **Windowed filters** look ``latency`` frames ahead: the radius times the passes, patch radius
    plus search radius for non-local means. What comes out is the offline result, at the start and
    at the end too, where boundary rules apply; causal forms have latency 0. Two exceptions, each
    because the offline result looks further ahead: the first ``radius`` frames of a Savitzky-Golay
    filter with boundary ``"interp"`` are those of ``"replicate"``, and a missing frame whose next
    present one is not within the window of one pass holds the last one. (A missing frame of the
    Hampel filter is filled between its neighbours as they came, not as they are cleaned.) The
    boundary ``"circular"`` is refused.

    **Recursive filters** have latency 0 and carry an estimate, in double precision.
    :class:`OneEuroFilter` gives the offline result. Of :class:`KalmanSmoother` this is the forward
    pass: what it gives for the last frame of all those so far. Missing frames hold the estimate of
    the last present one.

    Filters that learn from the whole sequence are refused.

    Frames are ``(..., J, 4)``; the leading axes are people, each of which can start anew by
    itself. Signs may flip freely. Memory does not grow. There are no gradients. Parameters of the
    filter are read when the first frame comes, and again after :meth:`flush` and :meth:`reset` of
    all.

    Args:
        filter: A filter of this package.

    Raises:
        TypeError: If the filter cannot be fed frame by frame.
        ValueError: If one of its settings needs the end of the sequence.
    """

    def __init__(self, filter: nn.Module) -> None:
        self.filter = filter
        self._plan = plan(filter)
        self._state: StreamState | None = None
        self._machine: Cascade | OneEuro | Tracker | None = None
        self._ages = (0, 0)  # of the youngest and the oldest: a GPU would have to be waited for

    @property
    def latency(self) -> int:
        """How many frames later the result of a frame comes out."""
        return self._plan.latency

    @property
    def state(self) -> StreamState | None:
        """All that is known, ``None`` before the first frame; it may be kept and set again."""
        return self._state

    @state.setter
    def state(self, state: StreamState | None) -> None:
        self._machine = None
        self._set(state)

    def push(self, frame: Tensor, weight: Tensor | None = None) -> Tensor | None:
        """Take a frame in, give a filtered one back.

        Args:
            frame: Quaternions ``(..., J, 4)`` of any norm, always of one shape, dtype and device.
            weight: Confidence ``(..., J)``, >= 0; 0 marks what is missing.

        Returns:
            Unit quaternions ``(..., J, 4)``, of the frame ``latency`` frames before, or ``None``
            where nobody had one yet. People who started later have NaN until theirs comes.

        Raises:
            TypeError: If ``frame`` or ``weight`` is not a tensor of a fitting dtype.
            ValueError: If a shape or device does not fit, or is another than before.
        """
        check_frame(frame, weight)
        with torch.inference_mode():
            result = self._push(frame, weight)
        return None if result is None else result.clone()  # outside: a plain tensor

    def flush(self) -> Tensor | None:
        """End the sequence, and start anew.

        Returns:
            The last frames ``(..., latency, J, 4)``, which are still due, by the boundary rule of
            the filter; fewer where there were fewer; ``None`` where there were none. People who
            started later have NaN for what was before.
        """
        state = self._state
        if state is None:
            return None
        layout = state.layout
        due = min(self._ages[1], self.latency)
        out = state.given[:, :, :0]
        if isinstance(self._plan, Windowed) and isinstance(state.memory, CascadeMemory) and due:
            with torch.inference_mode():
                out = at_the_end(self._plan, state.memory.passes[0], state.age, due)
                out = nearer(out, state.given[:, :, 1 + self.latency - due :])
        self.reset()
        *people, joints, _ = layout.shape
        out = out.permute(1, 2, 3, 0).reshape(*people, due, joints, 4)
        return out.to(layout.dtype, copy=True)

    def reset(self, people: int | slice | Tensor | None = None) -> None:
        """Start anew, as if nothing had come; frames that are still due are dropped.

        Args:
            people: Which: an index into the leading axes of the frames, or booleans of their
                shape; ``None``: all.

        Raises:
            IndexError: If there is no such person.
        """
        state = self._state
        if people is None or state is None:
            self.state = None
            return
        layout = state.layout
        chosen = torch.zeros(layout.shape[:-2], dtype=torch.bool, device=layout.device)
        chosen[people] = True
        chosen = chosen.reshape(-1)
        age, memory = torch.where(chosen, 0, state.age), state.memory.forgotten(chosen)
        self._set(StreamState(age, state.given, memory, layout))
        if self._machine is not None:
            self._machine.doubt()

    def _set(self, state: StreamState | None) -> None:
        self._state = state
        if state is None:
            self._ages = (0, 0)
        elif state.age.numel():
            self._ages = (int(state.age.min()), int(state.age.max()))

    def _push(self, frame: Tensor, weight: Tensor | None) -> Tensor | None:
        layout = self._checked(frame)
        people, latency, width = frame.shape[:-2].numel(), self.latency, self._plan.width
        work = frame.detach().reshape(people, *frame.shape[-2:])
        if weight is not None:
            weight = weight.expand(frame.shape[:-1]).reshape(people, -1)
        entering = entered(work.float() if frame.dtype.itemsize < 4 else work, weight)
        machine, state = self._begun(entering, layout)

        settled = self._ages[0] >= width
        age = state.age if settled else (state.age + 1).clamp_(max=width)
        memory, out = machine.step(state.memory, entering, None if settled else age)
        state = StreamState(age, _with_newest(state.given, entering), memory, layout)
        self._state = state
        youngest, oldest = self._ages = tuple(min(age + 1, width) for age in self._ages)
        if oldest <= latency:
            return None
        if youngest < width and isinstance(self._plan, Windowed):
            out = at_the_start(self._plan, memory.passes[0], age, out)
        out = nearer(out, state.given[:, :, 0])
        return out.movedim(0, -1).reshape(frame.shape).to(frame.dtype)

    def _checked(self, frame: Tensor) -> Layout:
        """Raise unless a frame is like those before."""
        layout = Layout(frame.shape, frame.dtype, frame.device)
        if self._state is not None and layout != self._state.layout:
            raise ValueError(f"frame must be {self._state.layout} as before, got {layout}.")
        return layout

    def _begun(self, entering: Entered, layout: Layout) -> tuple[Any, StreamState]:
        """What takes frames in, and the state before this one."""
        like = entering.q.movedim(0, -1)
        if self._state is None or self._machine is None:
            self._machine = self._plan.machine(like)
        if self._state is None:
            given = entering.q[:, :, None].expand(-1, -1, self.latency + 1, -1)
            age = torch.zeros(len(like), dtype=torch.int64, device=like.device)
            self._state = StreamState(age, given, self._machine.begin(entering), layout)
        return self._machine, self._state


def _with_newest(given: Tensor, frame: Entered) -> Tensor:
    """Frames as they came, one further; what has no direction holds the one before."""
    newest = frame.q
    if frame.directed is not None:
        newest = torch.where(frame.directed, newest, given[:, :, -1])
    return torch.cat([given[:, :, 1:], newest[:, :, None]], 2)
