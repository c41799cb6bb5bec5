"""BVH files for tests, put together from strings without the package under test."""

from collections.abc import Sequence

import numpy as np

ROTATIONS = "Zrotation Xrotation Yrotation"
POSITIONS = "Xposition Yposition Zposition"
ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")

FIRST_ROW = 10
"""Line of the first row of motion in a file of one joint without an end site."""

IRREGULAR = (
    b"HIERARCHY\r\n"
    b"ROOT  Left Hip:1.\xfc-\x85x\r\n"
    b"{  \r\n"
    b"\tOFFSET\t0.00 1e1  -.5\r\n"
    b"\tCHANNELS 6 xposition YPOSITION Zposition Zrotation Yrotation Xrotation \r\n"
    b"  JOINT\tRightShould_End\r\n"
    b"  {\r\n"
    b"    CHANNELS 6 Yrotation Xrotation Zrotation Zposition Xposition Yposition\r\n"
    b"    OFFSET 1 2 3\r\n"
    b"    End  Site\r\n"
    b"    {\r\n"
    b"      OFFSET 0 0 .25\r\n"
    b"    }\r\n"
    b"  }\r\n"
    b"  JOINT tail\r\n"
    b"  {\r\n"
    b"    OFFSET 1 2 3\r\n"
    b"    CHANNELS 1 Xrotation\r\n"
    b"  }\r\n"
    b"}\r\n"
    b"\r\n"
    b"MOTION\r\n"
    b"Frames:\t3\r\n"
    b"Frame Time: .0083333\r\n"
    b" 1.50 +2 3e0\t10 20.0 30.00  600 -5 .25 7 8.1250 9 4 \r\n"
    b"1.5 2 3 11 21 31 601 -5 0.5 7 8.25 9 5\r\n"
    b"\r\n"
    b"1.5\t2\t3\t12\t22\t32\t602\t-5\t0.75\t7\t8.5\t9\t6   \r\n"
    b"  \r\n"
)
"""A file of three frames in which hardly a line is written the usual way."""


def joint(
    name: str,
    channels: str = ROTATIONS,
    *children: list[str],
    offset: str = "0 10 0",
    end_site: str | None = None,
) -> list[str]:
    """Lines of a joint with its children; without ``end_site`` it has none."""
    inside = [f"OFFSET {offset}", f"CHANNELS {len(channels.split())} {channels}".strip()]
    for child in children:
        inside += child
    if end_site is not None:
        inside += ["End Site", "{", f"\tOFFSET {end_site}", "}"]
    return [f"JOINT {name}", "{", *(f"\t{line}" for line in inside), "}"]


def bvh_text(
    *roots: list[str],
    rows: Sequence[str | Sequence[float]],
    frames: object = None,
    frame_time: object = "0.01",
) -> str:
    """A whole file; rows are texts, or numbers that get six decimals."""
    lines = ["HIERARCHY"]
    for root in roots:
        lines += [root[0].replace("JOINT", "ROOT", 1), *root[1:]]
    count = len(rows) if frames is None else frames
    lines += ["MOTION", f"Frames: {count}", f"Frame Time: {frame_time}"]
    for row in rows:
        lines.append(row if isinstance(row, str) else " ".join(f"{value:.6f}" for value in row))
    return "".join(f"{line}\n" for line in lines)


def one_joint(*rows: str | Sequence[float], channels: str = ROTATIONS, **options: object) -> str:
    """A file of one joint, its rows from line ``FIRST_ROW`` on."""
    return bvh_text(joint("hip", channels, offset="0 0 0"), rows=rows, **options)


def rotation_channels(order: str) -> str:
    """``"ZXY"`` as the words of a line CHANNELS."""
    return " ".join(f"{axis}rotation" for axis in order)


def axis_matrix(axis: str, degrees: float) -> np.ndarray:
    """A right-handed turn about one axis, ``(3, 3)``."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    rows = {
        "X": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "Y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "Z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], dtype=np.float64)


def euler_matrix(order: str, degrees: Sequence[float]) -> np.ndarray:
    """Matrix of intrinsic turns: the first channel is the leftmost factor."""
    matrix = np.eye(3)
    for axis, angle in zip(order, degrees, strict=True):
        matrix = matrix @ axis_matrix(axis, angle)
    return matrix


def quaternion_matrix(q: np.ndarray) -> np.ndarray:
    """Matrices ``(..., 3, 3)`` of unit quaternions ``x, y, z, w``."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def euler_quaternion(order: str, degrees: np.ndarray) -> np.ndarray:
    """Unit quaternions ``(..., 4)`` of intrinsic turns ``(..., len(order))``."""
    q = np.zeros((*degrees.shape[:-1], 4))
    q[..., 3] = 1.0
    for column, axis in enumerate(order):
        half = np.deg2rad(degrees[..., column]) / 2
        turn = np.zeros_like(q)
        turn[..., "XYZ".index(axis)], turn[..., 3] = np.sin(half), np.cos(half)
        a, b, w, v = q[..., :3], turn[..., :3], q[..., 3:], turn[..., 3:]
        vector = w * b + v * a + np.cross(a, b)
        q = np.concatenate([vector, w * v - (a * b).sum(-1, keepdims=True)], -1)
    return q


def motion_rows(content: bytes) -> np.ndarray:
    """The numbers below ``Frame Time:``."""
    lines = content.decode("latin-1").split("\n")
    first = 1 + next(i for i, line in enumerate(lines) if line.lower().startswith("frame time"))
    return np.array(
        [[float(word) for word in line.split()] for line in lines[first:] if line.split()]
    )
