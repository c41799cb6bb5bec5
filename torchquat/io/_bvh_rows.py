"""The lower half of a BVH file: rows of numbers, and the rotations in them."""

import re
from collections import defaultdict
from collections.abc import Sequence
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
from torchquat.io._numbers import DECIMALS, fixed_point, plain_numbers
from torchquat.io.motion import error_at

__all__ = ["format_rows", "read_rotations", "read_rows", "replace_columns", "solve_angles"]

Array = NDArray[np.float64]

_IN_NUMBERS = b"0123456789+-.eE \t\r\n"
_SPACES = re.compile(rb"([ \t\r\n]+)")
_TOKEN = re.compile(rb"[^ \t\r\n]+")


def read_rows(path: Path, rows: Sequence[bytes], first: int, width: int) -> Array:
    """All numbers ``(T, width)``; ``first`` is the line number of the first row."""
    found = plain_numbers(rows)
    if found is not None:
        plain, counts = found
        if ((counts == 0) | (counts == width)).all():
            return plain.reshape(np.count_nonzero(counts), width)
    return _read_one_by_one(path, rows, first, width)


def _read_one_by_one(path: Path, rows: Sequence[bytes], first: int, width: int) -> Array:
    """:func:`read_rows` for numbers in any notation; says what is wrong with a row."""
    numbers: list[float] = []
    frames = 0
    for number, row in enumerate(rows, first):
        tokens = row.split()
        if not tokens:
            continue
        frames += 1
        try:
            parsed = list(map(float, tokens)) if not row.translate(None, _IN_NUMBERS) else []
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
    joints: Sequence[BvhJoint], q: Tensor, valid: Tensor, before: Array, wanted: Sequence[bool]
) -> tuple[list[int], Array]:
    """Columns of the wanted joints' rotations, and the angles for them [deg].

    Args:
        joints: All joints of the file.
        q: Their rotations ``(T, J, 4)``.
        valid: Which of these are present, booleans ``(T, J)``.
        before: Rows of the file ``(T, width)``: the first tells which of equal angles are meant.
        wanted: For each joint whether it is to be written.

    Raises:
        ValueError: If a rotation of a wanted joint is missing.
    """
    columns: list[int] = []
    angles = [np.empty((len(q), 0))]
    for axes, members in _by_axes(joints).items():
        members = [index for index in members if wanted[index]]
        if not members or not len(q):
            continue
        if not bool(valid[:, members].all()):
            raise ValueError("q must hold no missing rotation to be written, got some: fill them.")
        own = [joints[index].columns("rotation") for index in members]
        solved = nearest_euler(so3.normalize(q[:, members]), axes, before[0, own])
        columns += [column for each in own for column in each]
        angles.append(solved.reshape(len(q), -1))
    return columns, np.concatenate(angles, -1)


def format_rows(values: Array) -> list[bytes]:
    """The numbers of each row as fixed-point text, between single spaces."""
    formatted = fixed_point(values)
    if formatted is not None:
        return formatted
    template = b" ".join([f"%.{DECIMALS}f".encode()] * values.shape[1])
    rounded = np.round(values, DECIMALS) + 0.0  # no -0.000000
    return [template % tuple(row) for row in rounded.tolist()]


def replace_columns(rows: Sequence[bytes], columns: Sequence[int], values: Array) -> list[bytes]:
    """Rows with the values of some columns replaced, and every other byte as it was.

    Args:
        rows: Lines as they were read; blank ones stay.
        columns: Which columns, in any order.
        values: Their new values, one row for each that is not blank.

    Returns:
        The lines.
    """
    order = np.argsort(columns)
    places = np.asarray(columns)[order]
    runs = np.split(np.arange(len(places)), np.flatnonzero(np.diff(places) > 1) + 1)
    texts = [format_rows(values[:, order[run]]) for run in runs]
    spans = [(int(places[run[0]]), int(places[run[-1]]) + 1) for run in runs]
    frame = iter(range(len(values)))
    replaced = []
    for row in rows:
        if row.strip():
            now = next(frame)
            row = _replace_spans(row, spans, [text[now] for text in texts])
        replaced.append(row)
    return replaced


def _replace_spans(row: bytes, spans: Sequence[tuple[int, int]], texts: Sequence[bytes]) -> bytes:
    """A row with the numbers ``first`` to ``stop`` of each span replaced by a text."""
    pieces = row.split(b" ")
    if b"\t" in row or b"  " in row or row[:1].isspace() or pieces[-1].isspace():
        return _replace_among_spaces(row, spans, texts)
    ending = row[len(row.rstrip()) :]
    for (first, stop), text in zip(reversed(spans), reversed(texts), strict=True):
        pieces[first:stop] = [text + ending if stop == len(pieces) else text]
    return b" ".join(pieces)


def _replace_among_spaces(
    row: bytes, spans: Sequence[tuple[int, int]], texts: Sequence[bytes]
) -> bytes:
    """:func:`_replace_spans` where more than single spaces stand between the numbers."""
    pieces = _SPACES.split(row)
    start = 0 if pieces[0] else 2  # an empty piece stands before leading white space
    for (first, stop), text in zip(spans, texts, strict=True):
        for column, number in zip(range(first, stop), text.split(), strict=True):
            pieces[start + 2 * column] = number
    return b"".join(pieces)
