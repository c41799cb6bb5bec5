"""npz of SMPL parameters: AMASS with all joints in ``poses``, others with one key a part."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchquat.io._copies import PARTS, repeated, same
from torchquat.io._places import Part, Place
from torchquat.io._smpl import joint_names, leaf, read_parameters
from torchquat.io._trees import keys_of
from torchquat.io._zip import said
from torchquat.io.estimate import Layout, Track, read_track
from torchquat.io.motion import FormatError
from torchquat.io.npz import FRAME_RATES

__all__ = ["find", "frame_rate"]


def find(path: Path, tree: Mapping[str, Any]) -> Mapping[str, tuple[Layout, Track]]:
    """The one track: ``poses`` (T, 3 J), or ``smpl`` of ``global_orient`` and ``body_pose``."""
    if "poses" in tree:
        return {"poses": _poses(path, tree)}
    if "global_orient" in tree or "body_pose" in tree:
        layout, frames, joints = read_parameters(path, (), tree)
        return {"smpl": (layout, read_track(layout, joint_names(joints), 0, [True] * frames))}
    raise FormatError(
        f"{path}: expected the key 'poses', or 'global_orient' and 'body_pose', got {keys_of(tree)}"
    )


def frame_rate(path: Path, tree: Mapping[str, Any]) -> float | None:
    """Frames per second, where the file holds them."""
    for key in (*FRAME_RATES, "fps"):
        if key in tree:
            array = np.asarray(tree[key]).reshape(-1)
            number = float(array[0]) if array.size == 1 and array.dtype.kind in "fiu" else 0.0
            if not 0 < number < float("inf"):
                raise FormatError(f"{path}: {key}: expected frames per second, got {said(array)}")
            return number
    return None


def _poses(path: Path, tree: Mapping[str, Any]) -> tuple[Layout, Track]:
    poses = leaf(path, "poses", tree["poses"], ("T", "3 J"))
    frames, width = poses.shape
    if width % 3 or not width:
        raise FormatError(f"{path}: poses: expected a width of 3 J, got {width}")

    def part(key: str, start: int, stop: int) -> Part:
        numbers = np.asarray(tree[key], np.float64).reshape(frames, (stop - start) // 3, 3)
        place = Place((key,), np.arange(frames))
        return Part("rotvec", slice(start // 3, stop // 3), [place], numbers)

    spans = {key: span for key, span in PARTS.get(width, {}).items() if key in tree}
    for key, (start, stop) in spans.items():
        if not same(leaf(path, key, tree[key], (frames, stop - start)), poses[:, start:stop]):
            raise FormatError(f"{path}: {key}: expected what 'poses' holds, got other values")
    spans |= repeated(poses, tree, tree.__getitem__)
    copies = [part(key, *span) for key, span in spans.items()]
    translation = None
    if "trans" in tree:
        numbers = leaf(path, "trans", tree["trans"], (frames, 3))
        place = Place(("trans",), np.arange(frames))
        translation = Part("position", slice(0, 1), [place], numbers[:, None])
    layout = Layout([part("poses", 0, width)], translation, copies)
    return layout, read_track(layout, joint_names(width // 3), 0, [True] * frames)
