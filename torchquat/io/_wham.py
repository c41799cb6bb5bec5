"""``wham_output.pkl`` of WHAM: SMPL poses of several people, each seen in some frames."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchquat.io._places import Part, Place
from torchquat.io._smpl import joint_names, leaf, mapping
from torchquat.io.estimate import Layout, Track, read_track
from torchquat.io.motion import FormatError

__all__ = ["KEYS", "find", "looks_like"]

KEYS = ("pose", "trans", "pose_world", "trans_world", "frame_ids")


def looks_like(person: Any) -> bool:
    """Whether this is meant as a person of WHAM, complete or not."""
    return isinstance(person, Mapping) and ("pose" in person or "frame_ids" in person)


def find(path: Path, tree: Mapping[Any, Any]) -> Mapping[str, tuple[Layout, Track]]:
    """Two tracks for each person: rotation vectors (N, 72), translations (N, 3).

    The N rows stand for the frames ``frame_ids``; those between that are not there are missing.
    """
    found = {}
    for person, values in tree.items():
        mapping(path, f"{person}: ", values, KEYS)
        numbers = _frame_numbers(path, person, values["frame_ids"])
        frames = numbers - numbers[0]
        seen = np.isin(np.arange(frames[-1] + 1), frames)
        for pose, trans in (("pose", "trans"), ("pose_world", "trans_world")):
            stored = leaf(path, f"{person}: {pose}", values[pose], (len(frames), 72))
            place = Place((person, pose), frames)
            part = Part("rotvec", slice(0, 24), [place], stored.reshape(-1, 24, 3))
            position = leaf(path, f"{person}: {trans}", values[trans], (len(frames), 3))
            place = Place((person, trans), frames)
            layout = Layout([part], Part("position", slice(0, 1), [place], position[:, None]))
            track = read_track(layout, joint_names(24), int(numbers[0]), seen.tolist())
            found[f"{person}/{pose}"] = layout, track
    return found


def _frame_numbers(path: Path, person: Any, value: Any) -> np.ndarray[Any, np.dtype[np.int64]]:
    numbers = np.asarray(value)
    fits = numbers.ndim == 1 and numbers.dtype.kind in "iu" and len(numbers) > 0
    if not fits or (np.diff(numbers.astype(np.int64)) <= 0).any():
        got = f"{numbers.dtype} {numbers.shape}" if not fits else f"{numbers[:20].tolist()}"
        raise FormatError(
            f"{path}: {person}: frame_ids: expected frame numbers that increase, got {got}"
        )
    return numbers.astype(np.int64)
