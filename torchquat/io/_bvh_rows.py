"""The lower half of a BVH file: rows of numbers, and the rotations in them."""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchquat import so3
from torchquat.io._bvh_hierarchy import BvhJoint, parse_number, show
from torchquat.io._euler import euler_to_quaternion, nearest_euler
from torchquat.io.motion import error_at

__all__ = ["format_rows", "read_rotations", "read_rows", "replace_values", "solve_angles"]

Array = NDArray[np.float64]

DECIMALS = 6  # rounding of three angles: 2.6e-8 rad at most
_NOT_IN_NUMBERS = re.compile(rb"[^0-9+\-.eE \t\r\n]")
_SPACES = re.compile(rb"([ \t\r\n]+)")
_TOKEN = re.compile(rb"[^ \t\r\n]+")


def read_rows(path: Path, rows: Sequence[bytes], first: int, width: int) -> Array:
    """All numbers ``(T, width)``; ``first`` is the line number of the first row."""
    numbers: list[float] = []
    frames = 0
    for number, row in enumerate(rows, first):
        tokens = row.split()
        if not tokens:
            continue
        frames += 1
        try:
            parsed = [] if _NOT_IN_NUMBERS.search(row) else list(map(float, tokens))
        except ValueError:
            parsed = []
        if len(parsed) != len(tokens) or not all(map(isfinite, parsed)):
            _refuse_row(path, number, row)
        if len(parsed) != width:
            raise error_at(path, number, f"{width} values in a row", f"{len(parsed)}")
        numbers += parsed
    return np.array(numbers, dtype=np.float64).reshape(frames, width)


def _refuse_row(path: Path, number: int, row: bytes) -> NoReturn:
    """Raise the error for the first token of a row that is not a number."""
    for match in _TOKEN.finditer(row):
        parse_number(path, number, row, match[0], match.start())
    raise error_at(path, number, "numbers", show(row))


def _by_axes(joints: Sequence[BvhJoint]) -> dict[str, list[int]]:
    """Joints that share a rotation order are converted together."""
    groups: dict[str, list[int]] = defaultdict(list)
    for index, joint in enumerate(joints):
        if joint.axes:
            groups[joint.axes].append(index)
    return groups


def read_rotations(joints: Sequence[BvhJoint], values: Array) -> Tensor:
    """Rotations ``(T, J, 4)`` of all joints; the identity for those without channels."""
    q = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    q = q.repeat(len(values), len(joints), 1)
    for axes, members in _by_axes(joints).items():
        columns = [joints[index].columns("rotation") for index in members]
        q[:, members] = euler_to_quaternion(values[:, columns], axes)
    return q


def solve_angles(
    joints: Sequence[BvhJoint], q: Tensor, before: Array, wanted: Sequence[bool]
) -> tuple[list[int], Array]:
    """Columns of the wanted joints' rotations, and the angles for them [deg]."""
    columns: list[int] = []
    angles = [np.empty((len(q), 0))]
    for axes, members in _by_axes(joints).items():
        members = [index for index in members if wanted[index]]
        if not members or not len(q):
            continue
        if not bool(torch.isfinite(q[:, members]).all()):
            raise ValueError("q must hold no missing rotation to be written, got some: fill them.")
        own = [joints[index].columns("rotation") for index in members]
        solved = nearest_euler(so3.normalize(q[:, members]), axes, before[0, own])
        columns += [column for each in own for column in each]
        angles.append(solved.reshape(len(q), -1))
    return columns, np.concatenate(angles, -1)


def format_rows(values: Array) -> Iterator[list[bytes]]:
    """The numbers of each row as fixed-point text."""
    template = b" ".join([f"%.{DECIMALS}f".encode()] * values.shape[1])
    rounded = np.round(values, DECIMALS) + 0.0  # no -0.000000
    return ((template % tuple(row)).split() for row in rounded.tolist())


def replace_values(row: bytes, columns: Sequence[int], texts: Sequence[bytes]) -> bytes:
    """A row with some of its values replaced, and every other byte as it was."""
    pieces = _SPACES.split(row)
    start = 0 if pieces[0] else 2  # an empty piece stands before leading white space
    for column, text in zip(columns, texts, strict=True):
        pieces[start + 2 * column] = text
    return b"".join(pieces)
