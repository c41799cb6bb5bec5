"""The parameters of SMPL, SMPL-H and SMPL-X as files name them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchquat.io._places import Part, Place
from torchquat.io._trees import Array, array_of, keys_of
from torchquat.io.estimate import Layout
from torchquat.io.motion import FormatError

__all__ = ["joint_names", "leaf", "mapping", "read_parameters"]

_BODY = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2"),
    *("left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar"),
    *("right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow"),
    *("left_wrist", "right_wrist"),
)
_HANDS = ("left_hand", "right_hand")

# joints that each key may hold, in the order of SMPL-X; hands in principal components are not read
_KEYS = {
    "global_orient": (1,),
    "body_pose": (21, 23),
    "jaw_pose": (1,),
    "leye_pose": (1,),
    "reye_pose": (1,),
    "left_hand_pose": (15,),
    "right_hand_pose": (15,),
}
_NEEDED = ("global_orient", "body_pose")


def joint_names(joints: int) -> tuple[str, ...]:
    """Names of the first joints of SMPL, numbers after those of the body."""
    names = (*_BODY, *_HANDS) if joints == 24 else _BODY
    return (*names, *(f"joint_{index}" for index in range(len(names), joints)))[:joints]


def mapping(path: Path, where: str, tree: Any, needed: tuple[str, ...]) -> Mapping[str, Any]:
    """A mapping that has some keys, or an error."""
    if not isinstance(tree, Mapping) or any(key not in tree for key in needed):
        raise FormatError(f"{path}: {where}expected the keys {list(needed)}, got {keys_of(tree)}")
    return tree


def leaf(path: Path, where: str, value: Any, shape: tuple[int | str, ...]) -> Array:
    """An array of floating-point numbers of a shape (letters stand for any size), or an error."""
    numbers = array_of(value)
    fits = numbers is not None and len(numbers.shape) == len(shape)
    if numbers is not None and fits:
        sizes = zip(shape, numbers.shape, strict=True)
        fits = all(isinstance(wanted, str) or wanted == size for wanted, size in sizes)
    if numbers is None or not fits:
        wanted = str(shape).replace("'", "")
        raise FormatError(f"{path}: {where}: expected floats {wanted}, got {_kind_of(value)}")
    return numbers


def read_parameters(
    path: Path, prefix: tuple[Any, ...], tree: Any, position: tuple[str, ...] = ("transl", "trans")
) -> tuple[Layout, int, int]:
    """Where the pose in a mapping of SMPL parameters lies.

    Rotation vectors or matrices, told from each other by how many numbers a frame has. Optional
    parts that are something else are left alone.

    Args:
        path: Named in errors.
        prefix: Keys that lead to the mapping.
        tree: The mapping.
        position: Keys that may hold the translation.

    Returns:
        The layout, and how many frames and joints it has.
    """
    where = "".join(f"{key}: " for key in prefix)
    mapping(path, where, tree, _NEEDED)
    frames, joints, parts = -1, 0, []
    for key, counts in _KEYS.items():
        numbers = array_of(tree[key]) if key in tree else None
        found = _form_of(numbers, counts)
        if found is None or numbers is None or frames not in (-1, len(numbers)):
            if key in _NEEDED:
                wanted = " or ".join(f"({'T' if frames < 0 else frames}, {3 * n})" for n in counts)
                got = _kind_of(tree[key])
                raise FormatError(f"{path}: {where}{key}: expected floats {wanted}, got {got}")
            continue
        frames, (kind, count) = len(numbers), found
        shape = (frames, count, 3) if kind == "rotvec" else (frames, count, 3, 3)
        place = Place((*prefix, key), np.arange(frames))
        parts.append(Part(kind, slice(joints, joints + count), [place], numbers.reshape(shape)))
        joints += count
    return Layout(parts, _translation(path, prefix, tree, position, frames)), frames, joints


def _translation(
    path: Path, prefix: tuple[Any, ...], tree: Any, keys: tuple[str, ...], frames: int
) -> Part | None:
    for key in keys:
        if key in tree:
            where = "".join(f"{each}: " for each in prefix) + key
            numbers = leaf(path, where, tree[key], (frames, 3))
            place = Place((*prefix, key), np.arange(frames))
            return Part("position", slice(0, 1), [place], numbers[:, None])
    return None


def _form_of(numbers: Array | None, counts: tuple[int, ...]) -> tuple[str, int] | None:
    """Representation and number of joints, by the numbers a frame has."""
    if numbers is None or numbers.ndim < 2:
        return None
    width = math.prod(numbers.shape[1:])
    for count in counts:
        for kind, size in (("rotvec", 3), ("rotmat", 9)):
            if width == count * size:
                return kind, count
    return None


def _kind_of(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)}"
    return type(value).__name__
