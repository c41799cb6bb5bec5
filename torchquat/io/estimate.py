"""What a pose estimator put out: the tracks of its file, filtered and written back into it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from torchquat import missing
from torchquat.io._places import Part
from torchquat.io._trees import TreeFile
from torchquat.io.motion import Motion

__all__ = ["Estimate", "EstimateSource", "Layout", "Track", "TrackSource", "read_track"]

FilterTranslation = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class Track:
    """One person's rotations, in one frame of reference.

    Attributes:
        q: Rotations ``(T, J, 4)``, ``(x, y, z, w)``, float64, each in its parent's frame; NaN where
            nothing was observed.
        weight: Confidence ``(T, J)``: 1 where observed, else 0.
        names: One name per joint.
        frames: Number of every frame in the video, ``(T,)``; without gaps.
        translation: Position ``(T, 3)`` where the file has one; NaN where not observed.
    """

    q: Tensor
    weight: Tensor
    names: tuple[str, ...]
    frames: Tensor
    translation: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the numbers of one track lie in a file.

    Attributes:
        parts: The joints, in order.
        translation: The position, where there is one.
        copies: Where some joints lie a second time.
    """

    parts: Sequence[Part]
    translation: Part | None = None
    copies: Sequence[Part] = ()


@dataclass(frozen=True, eq=False)
class EstimateSource:
    """A file as it was read, with the tracks that were found in it."""

    path: Path
    file: TreeFile
    layouts: Mapping[str, Layout]
    tracks: Mapping[str, Track]

    def render(self, tracks: Mapping[str, Track]) -> bytes:
        """The file with other rotations and translations; all else as it was read."""
        leaves: dict[tuple[Any, ...], Any] = {}
        for name, layout in self.layouts.items():
            now, before = tracks[name], self.tracks[name]
            if now is before:
                continue
            for part in (*layout.parts, *layout.copies):
                leaves |= part.write(now.q, before.q)
            place, moved = layout.translation, now.translation is not before.translation
            if place and moved and now.translation is not None and before.translation is not None:
                leaves |= place.write(now.translation[:, None], before.translation[:, None])
        return self.file.rewritten(leaves)


@dataclass(frozen=True, eq=False)
class Estimate:
    """All tracks of an estimator's file, by the name of their place in it.

    Attributes:
        producer: Who writes such files: ``GVHMR``, ``WHAM``, ``PHALP`` or ``SMPL``.
        tracks: The tracks by name.
        frame_rate: Frames per second, where the file or the caller gave them.
        source: The rest of the file.
    """

    producer: str
    tracks: Mapping[str, Track]
    frame_rate: float | None
    source: EstimateSource

    def filtered(
        self, filter: nn.Module, *, translation: FilterTranslation | None = None
    ) -> Estimate:
        """All tracks filtered, each by itself.

        Args:
            filter: Module with ``forward(q, weight)`` on ``(T, J, 4)``, such as
                :class:`~torchquat.BilateralFilter`.
            translation: Called with positions ``(T, 3)``, NaN where not observed, and weights
                ``(T,)``, 1 or 0; gives positions ``(T, 3)``. ``None``: they stay as they are.
        """
        with torch.no_grad():
            done = self.with_rotations({k: filter(v.q, v.weight) for k, v in self.tracks.items()})
            if translation is None:
                return done
            return done.with_translations(
                {
                    name: translation(track.translation, track.weight[:, 0])
                    for name, track in self.tracks.items()
                    if track.translation is not None
                }
            )

    def with_rotations(self, rotations: Mapping[str, Tensor]) -> Estimate:
        """The same estimate with other rotations in some tracks.

        Args:
            rotations: Quaternions ``(T, J, 4)`` by track; NaN leaves a rotation as it is stored.

        Raises:
            ValueError: If there is no such track, or the shape is not that of the track.
        """
        tracks = dict(self.tracks)
        for name, q in rotations.items():
            track = self.track(name)
            if q.shape != track.q.shape:
                raise ValueError(
                    f"{name!r} must have shape {tuple(track.q.shape)}, got {tuple(q.shape)}."
                )
            q = q.detach().to("cpu", torch.float64)
            tracks[name] = replace(track, q=q, weight=missing.confidence(q))
        return replace(self, tracks=tracks)

    def with_translations(self, translations: Mapping[str, Tensor]) -> Estimate:
        """The same estimate with other positions in some tracks.

        Args:
            translations: Positions ``(T, 3)`` by track; NaN leaves one as it is stored.

        Raises:
            ValueError: If there is no such track, or it has no positions, or of another shape.
        """
        tracks = dict(self.tracks)
        for name, position in translations.items():
            track = self.track(name)
            shape = None if track.translation is None else tuple(track.translation.shape)
            if shape != tuple(position.shape):
                raise ValueError(
                    f"the translation of {name!r} must have shape {shape}, "
                    f"got {tuple(position.shape)}."
                )
            moved = position.detach().to("cpu", torch.float64)
            tracks[name] = replace(track, translation=moved)
        return replace(self, tracks=tracks)

    def track(self, name: str | None = None) -> Track:
        """A track by its name; the only one where none is given.

        Raises:
            ValueError: If there is none of that name, or more than one to choose from.
        """
        if name is None and len(self.tracks) == 1:
            return next(iter(self.tracks.values()))
        if name is None or name not in self.tracks:
            raise ValueError(
                f"{self.source.path}: track must be one of {list(self.tracks)}, got {name!r}."
            )
        return self.tracks[name]

    def motion(self, name: str | None = None) -> Motion:
        """One track as a motion, which :func:`torchquat.io.save` writes back into the whole file.

        Raises:
            ValueError: If there is no such track, or no frame rate.
        """
        track = self.track(name)
        if self.frame_rate is None:
            raise ValueError(
                f"{self.source.path}: expected frame_rate=..., got None: "
                f"a file of {self.producer} does not hold it."
            )
        name = name or next(iter(self.tracks))
        return Motion(
            q=track.q,
            frame_rate=self.frame_rate,
            names=track.names,
            root_position=track.translation,
            weight=track.weight,
            source=TrackSource(self, name),
        )

    def render(self) -> bytes:
        """The content of the file."""
        return self.source.render(self.tracks)


@dataclass(frozen=True, eq=False)
class TrackSource:
    """The file around one of its tracks."""

    estimate: Estimate
    name: str

    @property
    def suffix(self) -> str:
        """Ending of the name of such files."""
        return self.estimate.source.path.suffix.lower()

    def render(self, motion: Motion) -> bytes:
        """The whole file with the rotations of ``motion`` in this track."""
        return self.estimate.with_rotations({self.name: motion.q}).render()


def read_track(
    layout: Layout, names: Sequence[str], first: int, observed: Sequence[bool] | Tensor
) -> Track:
    """The track at a place.

    Args:
        layout: Where its numbers lie.
        names: One name per joint.
        first: Number of its first frame in the video.
        observed: For each frame whether what stands there was seen, ``(T,)``.
    """
    seen = torch.as_tensor(observed, dtype=torch.bool)
    frames = len(seen)
    q = torch.cat([part.read(frames) for part in layout.parts], -2)
    q = torch.where(seen[:, None, None], q, torch.nan)
    translation = None
    if layout.translation is not None:
        translation = layout.translation.read(frames)[:, 0]
        translation = torch.where(seen[:, None], translation, torch.nan)
    numbers = torch.arange(first, first + frames)
    return Track(q, missing.confidence(q), tuple(names), numbers, translation)
