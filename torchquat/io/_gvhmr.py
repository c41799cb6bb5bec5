"""``hmr4d_results.pt`` of GVHMR: SMPL-X parameters in the world and before the camera."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchquat.io._smpl import joint_names, mapping, read_parameters
from torchquat.io.estimate import Layout, Track, read_track

__all__ = ["KEYS", "find"]

KEYS = ("smpl_params_global", "smpl_params_incam")


def find(path: Path, tree: Any) -> Mapping[str, tuple[Layout, Track]]:
    """The two tracks: tensors ``global_orient`` (T, 3), ``body_pose`` (T, 63), ``transl`` (T, 3).

    Everything else (``betas``, ``K_fullimg``, ``net_outputs``) is carried along.
    """
    mapping(path, "", tree, KEYS)
    found = {}
    for key in KEYS:
        layout, frames, joints = read_parameters(path, (key,), tree[key])
        found[key] = layout, read_track(layout, joint_names(joints), 0, [True] * frames)
    return found
