"""Where in a file the rotations of a track lie, and how they are written there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchquat.io._trees import Array
from torchquat.representation import continuous_rotvec, convert

__all__ = ["Part", "Place"]


@dataclass(frozen=True, eq=False)
class Place:
    """One array of a file.

    Attributes:
        path: Keys that lead to it.
        frames: The frames of the track that its rows stand for, ``(N,)``.
    """

    path: tuple[Any, ...]
    frames: np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class Part:
    """Some joints of a track, in one array or in one for every frame.

    Attributes:
        kind: Representation: ``rotvec``, ``rotmat``, or ``position`` for what is no rotation.
        joints: Which joints; of a position, joint 0.
        places: Where their numbers lie.
        stored: The numbers of all places ``(N, J, *shape)``, those of one after those of another.
    """

    kind: str
    joints: slice
    places: Sequence[Place]
    stored: Array

    @property
    def frames(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Frames of the track that the rows of ``stored`` stand for."""
        return np.concatenate([np.zeros(0, np.int64), *(place.frames for place in self.places)])

    def read(self, frames: int) -> Tensor:
        """Quaternions ``(T, J, 4)``, or positions ``(T, 1, 3)``; NaN where there are none."""
        rows = torch.from_numpy(self.stored)
        values = rows if self.kind == "position" else convert(rows, self.kind, "quat_xyzw")
        result = values.new_full((frames, *values.shape[1:]), torch.nan)
        result[torch.from_numpy(self.frames)] = values
        return result

    def write(self, now: Tensor, before: Tensor) -> dict[tuple[Any, ...], Array]:
        """The arrays of all places with new values, in the layout of ``stored``.

        Joints that did not change keep their numbers, and so does what is missing.

        Args:
            now: Quaternions or positions of the whole track, ``(T, J, 4)`` or ``(T, 1, 3)``.
            before: Those that were read.

        Returns:
            Numbers by path.
        """
        now, before = now[:, self.joints], before[:, self.joints]
        frames = torch.from_numpy(self.frames)
        same = (now == before) | (now.isnan() & before.isnan())
        changed = ~same[frames].all(-1).all(0)
        solved = self._solved(now)[frames].numpy()
        entries = tuple(range(2, solved.ndim))
        written = np.isfinite(solved).all(entries) & changed.numpy()
        numbers = np.where(np.expand_dims(written, entries), solved, self.stored)
        stops = np.cumsum([len(place.frames) for place in self.places])
        pieces = np.split(numbers, stops[:-1])
        return {place.path: piece for place, piece in zip(self.places, pieces, strict=True)}

    def _solved(self, now: Tensor) -> Tensor:
        if self.kind == "position":
            return now
        if self.kind == "rotvec":
            start = torch.from_numpy(self.stored[0]) if len(self.stored) else None
            return continuous_rotvec(now, start)
        return convert(now, "quat_xyzw", self.kind)
