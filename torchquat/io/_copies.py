"""Parts of ``poses`` that an npz holds a second time, and that have to change with it."""

from collections.abc import Callable, Collection

import numpy as np

from torchquat.io._zip import Anything

__all__ = ["PARTS", "repeated", "same"]

# where SMPL-H (52 joints) and SMPL-X (55) files keep parts of `poses` a second time
PARTS = {
    156: {"root_orient": (0, 3), "pose_body": (3, 66), "pose_hand": (66, 156)},
    165: {
        "root_orient": (0, 3),
        "pose_body": (3, 66),
        "pose_jaw": (66, 69),
        "pose_eye": (69, 75),
        "pose_hand": (75, 165),
    },
}

# names of parts in other files, and the column where each begins
_STARTS = {"root_orient": 0, "global_orient": 0, "pose_body": 3, "body_pose": 3}
_MORE_STARTS = {
    156: {"left_hand_pose": 66, "right_hand_pose": 111},
    165: {
        "jaw_pose": 66,
        "leye_pose": 69,
        "reye_pose": 72,
        "left_hand_pose": 75,
        "right_hand_pose": 120,
    },
}


def repeated(
    poses: Anything, keys: Collection[str], array: Callable[[str], Anything]
) -> dict[str, tuple[int, int]]:
    """Keys with the name and the numbers of a part of ``poses``, besides those of :data:`PARTS`.

    Under such a name other numbers are something else, and no error: no format says what they are.

    Args:
        poses: Rotation vectors ``(T, 3 J)``.
        keys: Names of all arrays of the file.
        array: Gives one by its name.

    Returns:
        First column, and the one after the last, by key.
    """
    frames, width = poses.shape
    found = {}
    for key, start in (_STARTS | _MORE_STARTS.get(width, {})).items():
        if key not in keys or key in PARTS.get(width, {}):
            continue
        copy = array(key)
        if copy.dtype.kind != "f" or copy.shape[:1] != (frames,) or not copy.size:
            continue
        stop = start + copy.size // frames
        if stop > width or (stop - start) % 3:
            continue
        if same(copy.reshape(frames, -1), poses[:, start:stop]):
            found[key] = start, stop
    return found


def same(copy: Anything, part: Anything) -> bool:
    """Whether numbers are equal, but for the rounding of another dtype."""
    return np.allclose(copy.astype(float), part.astype(float), atol=1e-5, equal_nan=True)
