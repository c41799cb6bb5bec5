"""BVH files: read to quaternions, and written back with nothing but rotations changed."""

import re
import warnings
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchquat.io._bvh_hierarchy import (
    BvhJoint,
    Hierarchy,
    format_hierarchy,
    parse_count,
    parse_hierarchy,
    parse_number,
    show,
)
from torchquat.io._bvh_rows import (
    format_rows,
    read_rotations,
    read_rows,
    replace_columns,
    solve_angles,
)
from torchquat.io.motion import FormatError, Motion, error_at
from torchquat.skeleton import Skeleton

__all__ = ["BvhSource", "new_bvh", "read_bvh"]

Array = NDArray[np.float64]

_FRAMES = re.compile(rb"\s*frames\s*:\s*(\S*)\s*", re.IGNORECASE)
_FRAME_TIME = re.compile(rb"\s*frame[ \t]+time\s*:\s*(\S*)\s*", re.IGNORECASE)
_BOM = b"\xef\xbb\xbf"


@dataclass(frozen=True, eq=False)
class BvhSource:
    """A BVH file as it was read.

    Attributes:
        header: Everything above the first row of motion, byte for byte.
        rows: The rows of motion and blank lines among them, with their line ends.
        joints: Joints and their columns.
        values: The numbers of the rows ``(T, width)``.
        q: The rotations that were read ``(T, J, 4)``.
    """

    header: bytes
    rows: Sequence[bytes]
    joints: Sequence[BvhJoint]
    values: Array
    q: Tensor

    def render(self, motion: Motion) -> bytes:
        """The file with the rotations of ``motion``.

        Joints whose rotations did not change keep their text. The others get six decimals and the
        Euler solution nearest to the frame before.

        Raises:
            ValueError: If the shape of the motion is not that of the file, or a rotation of a joint
                that changed is missing.
        """
        if motion.q.shape != self.q.shape:
            raise ValueError(
                f"q must have shape {tuple(self.q.shape)}, got {tuple(motion.q.shape)}."
            )
        changed = (motion.q != self.q).any(-1).any(0).tolist()
        columns, angles = solve_angles(self.joints, motion.q, motion.valid, self.values, changed)
        if not columns:
            return self.header + b"".join(self.rows)
        return self.header + b"".join(replace_columns(self.rows, columns, angles))


def read_bvh(path: Path, *, lenient: bool = False) -> Motion:
    """Read a BVH file.

    Any order of rotation and position channels, 0 to 6 on every joint; a rotation axis that a joint
    does not have is 0. Names are kept byte for byte, also where two joints share one.

    Args:
        path: File to read.
        lenient: Where ``Frames:`` does not match the rows, warn and use the rows.

    Returns:
        Rotations, frame rate, skeleton and the position of the first joint.

    Raises:
        FormatError: With line (and column, for a number) where the file is not BVH.
        OSError: If the file cannot be read.
    """
    lines = path.read_bytes().splitlines(keepends=True)
    numbered = iter(enumerate((line.removeprefix(_BOM) for line in lines), 1))
    hierarchy = parse_hierarchy(path, numbered)
    frames_line, frames = _read_frames(path, numbered)
    last, frame_time = _read_frame_time(path, numbered)
    header, rows = lines[:last], lines[last:]
    values = read_rows(path, rows, last + 1, hierarchy.width)
    if not hierarchy.width:
        values = np.empty((min(frames, len(rows)), 0))  # a row of no values is an empty line
    if len(values) != frames:
        found = f"expected {frames} rows of motion, got {len(values)}"
        if not lenient:
            raise FormatError(f"{path}:{frames_line}: {found}")
        # the line that is named is that of whoever called `io.load`
        warnings.warn(f"{path}:{frames_line}: {found}: using these", stacklevel=3)
        header[frames_line - 1] = header[frames_line - 1].replace(
            b"%d" % frames, b"%d" % len(values)
        )
    q = read_rotations(hierarchy.joints, values)
    return Motion(
        q=q,
        frame_rate=1.0 / frame_time,
        names=tuple(joint.name for joint in hierarchy.joints),
        skeleton=_skeleton(hierarchy),
        root_position=_root_position(hierarchy.joints[0], values),
        source=BvhSource(b"".join(header), rows, hierarchy.joints, values, q),
    )


def new_bvh(motion: Motion) -> bytes:
    """A BVH file for a motion that came from elsewhere: rotations in the order Z, X, Y.

    Raises:
        ValueError: If the motion has no skeleton, or a rotation or a position is missing, or a name
            cannot be told from what stands around it: names are never replaced.
    """
    skeleton = motion.skeleton
    if skeleton is None:
        raise ValueError("motion must have a skeleton to be written as BVH, got none.")
    if motion.root_position is not None and not bool(motion.root_position.isfinite().all()):
        raise ValueError(
            "root_position must hold no missing position to be written, got some: fill them."
        )
    _check_names(skeleton.names)
    order = _depth_first(skeleton.parents)
    joints = _new_joints(skeleton, order)
    values = np.zeros((len(motion.q), sum(len(joint.channels) for joint in joints)))
    for index, joint in enumerate(joints):
        if joint.parent < 0:
            held = index > 0 or motion.root_position is None
            position = joint.offset if held else motion.root_position
            values[:, joint.columns("position")] = np.asarray(position)
    columns, angles = solve_angles(
        joints, motion.q[:, order], motion.valid[:, order], values, [True] * len(joints)
    )
    values[:, columns] = angles
    end_sites = [(order.index(joint), offset) for joint, offset in skeleton.end_sites]
    header = [
        "HIERARCHY",
        *format_hierarchy(Hierarchy(joints, end_sites)),
        "MOTION",
        f"Frames: {len(values)}",
        f"Frame Time: {1.0 / motion.frame_rate:.8f}",
    ]
    text = "".join(f"{line}\n" for line in header).encode("utf-8", "surrogateescape")
    return text + b"".join(row + b"\n" for row in format_rows(values))


def _check_names(names: Sequence[str]) -> None:
    """Raise for names that would not be read as they were written."""
    for name in names:
        words = re.split("[ \t]", name)
        if re.search("[\r\n]", name) or not words[0] or words[-1] in ("", "{", "}"):
            raise ValueError(
                "names must be of one line, neither empty nor with white space around them or a "
                f"brace for a last word, to be written, got {name!r}."
            )


def _depth_first(parents: Sequence[int]) -> list[int]:
    """Joints in the order in which a BVH file lists them: each subtree in one piece."""
    children: dict[int, list[int]] = defaultdict(list)
    for joint, parent in enumerate(parents):
        children[parent].append(joint)
    order: list[int] = []
    waiting = children[-1][::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += children[order[-1]][::-1]
    return order


def _new_joints(skeleton: Skeleton, order: Sequence[int]) -> list[BvhJoint]:
    """Joints with six channels on roots and three elsewhere."""
    joints: list[BvhJoint] = []
    column = 0
    for old in order:
        parent = skeleton.parents[old]
        x, y, z = skeleton.offsets[old].tolist()
        position = () if parent >= 0 else ("Xposition", "Yposition", "Zposition")
        channels = (*position, "Zrotation", "Xrotation", "Yrotation")
        new_parent = order.index(parent) if parent >= 0 else -1
        joints.append(BvhJoint(skeleton.names[old], new_parent, (x, y, z), channels, column))
        column += len(channels)
    return joints


def _read_frames(path: Path, lines: Iterator[tuple[int, bytes]]) -> tuple[int, int]:
    """Number of the line ``Frames:``, and what it says."""
    number, line, match = _next_match(path, lines, _FRAMES, "Frames:")
    frames = parse_count(match[1])
    if frames is None:
        raise error_at(path, number, "Frames: and a count >= 0", show(line))
    return number, frames


def _read_frame_time(path: Path, lines: Iterator[tuple[int, bytes]]) -> tuple[int, float]:
    """Number of the line ``Frame Time:``, and the seconds there."""
    number, line, match = _next_match(path, lines, _FRAME_TIME, "Frame Time:")
    seconds = parse_number(path, number, line, match[1], match.start(1))
    if not (seconds > 0 and 1.0 / seconds < float("inf")):
        raise error_at(path, number, "Frame Time: and seconds > 0", show(line))
    return number, seconds


def _next_match(
    path: Path, lines: Iterator[tuple[int, bytes]], pattern: re.Pattern[bytes], expected: str
) -> tuple[int, bytes, re.Match[bytes]]:
    for number, line in lines:
        if line.strip():
            match = pattern.fullmatch(line)
            if match is None:
                raise error_at(path, number, expected, show(line))
            return number, line, match
    raise FormatError(f"{path}: expected {expected}, got the end of the file")


def _skeleton(hierarchy: Hierarchy) -> Skeleton:
    joints = hierarchy.joints
    return Skeleton(
        names=tuple(joint.name for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        offsets=torch.tensor([joint.offset for joint in joints], dtype=torch.float64),
        end_sites=tuple(hierarchy.end_sites),
    )


def _root_position(root: BvhJoint, values: Array) -> Tensor:
    """Position of the first joint ``(T, 3)``: its channels, and its offset on axes without one."""
    position = np.tile(np.array(root.offset), (len(values), 1))
    for column in root.columns("position"):
        axis = "XYZ".index(root.channels[column - root.column][0])
        position[:, axis] = values[:, column]
    return torch.from_numpy(position)
