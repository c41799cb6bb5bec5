"""The upper half of a BVH file: joints, offsets and channels."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from torchquat.io.motion import FormatError, error_at

__all__ = [
    "BvhJoint",
    "Hierarchy",
    "format_hierarchy",
    "parse_count",
    "parse_hierarchy",
    "parse_number",
    "show",
]

_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_CHANNELS = {
    f"{axis}{kind}".encode().lower(): f"{axis}{kind}"
    for axis in "XYZ"
    for kind in ("position", "rotation")
}


@dataclass
class BvhJoint:
    """One joint: its channels fill the columns from ``column`` on."""

    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: tuple[str, ...] = ()
    column: int = 0

    @property
    def axes(self) -> str:
        """Axes of the rotation channels in their order, such as ``"ZXY"``."""
        return "".join(name[0] for name in self.channels if name.endswith("rotation"))

    def columns(self, kind: str) -> list[int]:
        """Columns of the channels of one kind, ``"position"`` or ``"rotation"``."""
        return [self.column + i for i, name in enumerate(self.channels) if name.endswith(kind)]


@dataclass
class Hierarchy:
    """All joints, parents first, and the tips of the last bones."""

    joints: list[BvhJoint] = field(default_factory=list)
    end_sites: list[tuple[int, tuple[float, float, float]]] = field(default_factory=list)

    @property
    def width(self) -> int:
        """Values in a row of motion."""
        return sum(len(joint.channels) for joint in self.joints)


@dataclass
class _Block:
    """An open brace: a joint's, or an end site's."""

    joint: int
    is_end_site: bool
    line: int
    has_offset: bool = False
    has_channels: bool = False


def parse_number(path: Path, number: int, line: bytes, token: bytes, start: int = 0) -> float:
    """A finite decimal number in ASCII, or an error with line and column."""
    value = float(token) if _NUMBER.fullmatch(token) else np.inf
    if not np.isfinite(value):
        column = line.find(token, start) + 1
        raise error_at(path, number, "a number", show(token), column)
    return value


def parse_count(token: bytes) -> int | None:
    """A count in decimal digits, at most eighteen; ``None`` if it is none."""
    return int(token) if token.isdigit() and len(token) <= 18 else None


def parse_hierarchy(path: Path, lines: Iterator[tuple[int, bytes]]) -> Hierarchy:
    """Read everything up to and including the line ``MOTION``.

    Args:
        path: Named in errors.
        lines: Numbers and lines; consumed as far as this half goes.

    Returns:
        The joints in the order of the file.

    Raises:
        FormatError: At the first line that is not what must stand there.
    """
    hierarchy = Hierarchy()
    words = _words(lines)
    number, line, keyword, _ = _next(path, words, "HIERARCHY")
    if keyword != b"hierarchy":
        raise error_at(path, number, "HIERARCHY", show(line))
    open_blocks: list[_Block] = []
    column = 0  # of the next channel
    while True:
        number, line, keyword, rest = _next(path, words, "} or MOTION")
        block = open_blocks[-1] if open_blocks else None
        if block is None and keyword == b"motion" and not rest:
            if not hierarchy.joints:
                raise error_at(path, number, "ROOT", show(line))
            return hierarchy
        if keyword == (b"joint" if block else b"root") and not (block and block.is_end_site):
            parent = block.joint if block else -1
            name = rest.decode("utf-8", "surrogateescape")
            if not name:
                raise error_at(path, number, f"a name after {show(line)}", "none")
            hierarchy.joints.append(BvhJoint(name, parent, column=column))
            _open(path, words, number)
            open_blocks.append(_Block(len(hierarchy.joints) - 1, False, number))
        elif block is None:
            raise error_at(path, number, "ROOT or MOTION", show(line))
        elif keyword == b"end" and rest.lower() == b"site" and not block.is_end_site:
            _open(path, words, number)
            open_blocks.append(_Block(block.joint, True, number))
        elif keyword == b"offset" and not block.has_offset:
            offset = _parse_offset(path, number, line, rest)
            block.has_offset = True
            if block.is_end_site:
                hierarchy.end_sites.append((block.joint, offset))
            else:
                hierarchy.joints[block.joint].offset = offset
        elif keyword == b"channels" and not (block.is_end_site or block.has_channels):
            if block.joint != len(hierarchy.joints) - 1:
                raise error_at(path, number, "CHANNELS before the first child", show(line))
            channels = hierarchy.joints[block.joint].channels = _parse_channels(path, number, rest)
            column += len(channels)
            block.has_channels = True
        elif keyword == b"}" and not rest and block.has_offset:
            open_blocks.pop()
        else:
            raise error_at(path, number, _wanted(block), show(line))


def format_hierarchy(hierarchy: Hierarchy) -> list[str]:
    """The lines that :func:`parse_hierarchy` reads, ``HIERARCHY`` and ``MOTION`` left out."""
    lines: list[str] = []

    def put(depth: int, text: str) -> None:
        lines.append("\t" * depth + text)

    def put_offset(depth: int, offset: tuple[float, float, float]) -> None:
        put(depth, "OFFSET " + " ".join(f"{value:.6f}" for value in offset))

    open_joints: list[int] = []
    for index, joint in enumerate(hierarchy.joints):
        while open_joints and open_joints[-1] != joint.parent:
            open_joints.pop()
            put(len(open_joints), "}")
        depth = len(open_joints)
        put(depth, f"{'JOINT' if depth else 'ROOT'} {joint.name}")
        put(depth, "{")
        put_offset(depth + 1, joint.offset)
        put(depth + 1, f"CHANNELS {len(joint.channels)} {' '.join(joint.channels)}")
        open_joints.append(index)
        for end_site in (offset for parent, offset in hierarchy.end_sites if parent == index):
            put(depth + 1, "End Site")
            put(depth + 1, "{")
            put_offset(depth + 2, end_site)
            put(depth + 1, "}")
    for depth in reversed(range(len(open_joints))):
        put(depth, "}")
    return lines


def _wanted(block: _Block) -> str:
    """What may stand inside an open brace, for an error."""
    wanted = [] if block.has_offset else ["OFFSET"]
    if not block.is_end_site:
        wanted += ([] if block.has_channels else ["CHANNELS"]) + ["JOINT", "End Site"]
    return ", ".join([*wanted, *(["}"] if block.has_offset else [])])


def _words(lines: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes, bytes, bytes]]:
    """Number, line, lower-case keyword and the rest of every line that is not blank.

    A brace at the end of a line, or at its start, counts as a line of its own.
    """
    for number, line in lines:
        text = line.strip(b" \t\r\n")
        parts = [text]
        if len(text) > 1 and text.endswith((b"{", b"}")) and text[-2:-1] in b" \t":
            parts = [text[:-1].rstrip(b" \t"), text[-1:]]
        for part in parts:
            keyword = part.replace(b"\t", b" ").partition(b" ")[0]
            if keyword:
                yield number, line, keyword.lower(), part[len(keyword) :].strip(b" \t")


def _next(
    path: Path, words: Iterator[tuple[int, bytes, bytes, bytes]], expected: str
) -> tuple[int, bytes, bytes, bytes]:
    for word in words:
        return word
    raise FormatError(f"{path}: expected {expected}, got the end of the file")


def _open(path: Path, words: Iterator[tuple[int, bytes, bytes, bytes]], above: int) -> None:
    number, line, keyword, rest = _next(path, words, f"{{ for line {above}")
    if keyword != b"{" or rest:
        raise error_at(path, number, "{", show(line))


def _parse_offset(path: Path, number: int, line: bytes, rest: bytes) -> tuple[float, float, float]:
    tokens = rest.split()
    if len(tokens) != 3:
        raise error_at(path, number, "OFFSET and 3 numbers", f"{len(tokens)}")
    x, y, z = (parse_number(path, number, line, token) for token in tokens)
    return x, y, z


def _parse_channels(path: Path, number: int, rest: bytes) -> tuple[str, ...]:
    count, *names = rest.split() or [b""]
    if parse_count(count) != len(names):
        raise error_at(path, number, f"CHANNELS {len(names)}", f"CHANNELS {show(count)}")
    channels: list[str] = []
    for name in names:
        channel = _CHANNELS.get(name.lower())
        if channel is None:
            raise error_at(path, number, f"one of {', '.join(_CHANNELS.values())}", show(name))
        if channel in channels:
            raise error_at(path, number, "every channel once", f"{channel} twice")
        channels.append(channel)
    return tuple(channels)


def show(text: bytes, limit: int = 60) -> str:
    """A token or line for an error message."""
    text = text.strip()
    shown = text[:limit].decode("utf-8", "backslashreplace")
    return repr(shown + ("..." if len(text) > limit else ""))
