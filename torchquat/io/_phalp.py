"""``results/*.pkl`` of PHALP and of 4D-Humans, which tracks with it: people frame by frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from torchquat.io._places import Part, Place
from torchquat.io._smpl import joint_names, leaf, mapping
from torchquat.io._trees import Array
from torchquat.io.estimate import Layout, Track, read_track
from torchquat.io.motion import FormatError

__all__ = ["KEYS", "find", "looks_like"]

KEYS = ("tid", "tracked_time", "smpl")

_ROTATIONS = {"global_orient": (0, 1), "body_pose": (1, 24)}


@dataclass(frozen=True)
class _Entry:
    """A person in one frame."""

    frame: int
    key: Any
    index: int
    observed: bool
    numbers: Mapping[str, Array]


def looks_like(frame: Any) -> bool:
    """Whether this is meant as a frame of PHALP, complete or not."""
    return isinstance(frame, Mapping) and ("tid" in frame or "tracked_ids" in frame)


def find(path: Path, tree: Mapping[Any, Any]) -> Mapping[str, tuple[Layout, Track]]:
    """One track for each person: rotation matrices (1, 3, 3) and (23, 3, 3) in every frame.

    Every frame lists people (``tid``) and, in the same order, what is known of them. Where
    ``tracked_time`` is not 0, a person is only predicted: such an entry is missing, and its
    rotations are written when the track was filled.
    """
    people: dict[Any, list[_Entry]] = {}
    for number, (key, frame) in enumerate(tree.items()):
        mapping(path, f"{key}: ", frame, KEYS)
        for person, entry in _entries(path, number, key, frame):
            others = people.setdefault(person, [])
            if others and others[-1].frame == number:
                raise FormatError(f"{path}: {key}: tid: expected {person} once, got it twice")
            others.append(entry)
    found = {}
    for person, entries in sorted(people.items()):
        first = entries[0].frame
        observed = np.zeros(entries[-1].frame + 1 - first, bool)
        observed[[entry.frame - first for entry in entries]] = [e.observed for e in entries]
        layout = _layout(entries)
        track = read_track(layout, joint_names(24), first, observed.tolist())
        found[str(person)] = layout, track
    return found


def _entries(
    path: Path, number: int, key: Any, frame: Mapping[str, Any]
) -> list[tuple[Any, _Entry]]:
    people = _whole_numbers(path, f"{key}: tid", frame["tid"])
    since = _whole_numbers(path, f"{key}: tracked_time", frame["tracked_time"])
    lists = [name for name in ("tracked_time", "smpl", "camera") if name in frame]
    for name in lists:
        found = len(_listed(path, f"{key}: {name}", frame[name]))
        if found != len(people):
            raise FormatError(
                f"{path}: {key}: {name}: expected {len(people)} entries as in 'tid', got {found}"
            )
    entries = []
    for index, person in enumerate(people):
        where = f"{key}: smpl: {index}: "
        smpl = mapping(path, where, frame["smpl"][index], tuple(_ROTATIONS))
        numbers = {
            name: leaf(path, where + name, smpl[name], (stop - start, 3, 3))
            for name, (start, stop) in _ROTATIONS.items()
        }
        if "camera" in frame:
            value = frame["camera"][index]
            numbers["camera"] = leaf(path, f"{key}: camera: {index}", value, (3,))
        entries.append((person, _Entry(number, key, index, since[index] == 0, numbers)))
    return entries


def _listed(path: Path, where: str, value: Any) -> Sequence[Any]:
    """A list, a tuple or an array of one axis."""
    if isinstance(value, list | tuple) or getattr(value, "ndim", 0) == 1:
        return value
    raise FormatError(f"{path}: {where}: expected a list, got {type(value).__name__}")


def _whole_numbers(path: Path, where: str, value: Any) -> list[int]:
    found = _listed(path, where, value)
    for each in found:
        if not isinstance(each, Integral) and not _is_whole(each):
            raise FormatError(f"{path}: {where}: expected whole numbers, got {type(each).__name__}")
    return [int(each) for each in found]


def _is_whole(value: Any) -> bool:
    """Whether an array or a tensor without axes holds a whole number."""
    kind = str(getattr(value, "dtype", ""))
    return "int" in kind and getattr(value, "ndim", 1) == 0


def _layout(entries: list[_Entry]) -> Layout:
    """The arrays of one person, one of a kind for every frame."""
    first = entries[0].frame

    def part(kind: str, start: int, stop: int, name: str, *path: str) -> Part:
        own = [entry for entry in entries if name in entry.numbers]
        places = [
            Place((e.key, *path[:1], e.index, *path[1:]), np.array([e.frame - first])) for e in own
        ]
        stored = np.stack([entry.numbers[name] for entry in own])
        return Part(
            kind, slice(start, stop), places, stored if kind == "rotmat" else stored[:, None]
        )

    parts = [
        part("rotmat", start, stop, name, "smpl", name)
        for name, (start, stop) in _ROTATIONS.items()
    ]
    has_camera = any("camera" in entry.numbers for entry in entries)
    return Layout(parts, part("position", 0, 1, "camera", "camera") if has_camera else None)
