"""What a file is read as: one motion, or all tracks of an estimator."""

import zipfile
from dataclasses import replace
from pathlib import Path

from _batch import ESTIMATORS

from torchquat import io
from torchquat.io import Motion
from torchquat.io.npz import FRAME_RATES

__all__ = ["read"]


def read(
    path: Path, *, frame_rate: float, trust_pickle: bool
) -> tuple[dict[str, Motion], io.Estimate | None]:
    """All motions of a file by name, one without a name unless it is an estimator's.

    Args:
        path: File to read.
        frame_rate: Of files that do not hold theirs.
        trust_pickle: Whether a pickle may be run.

    Raises:
        ValueError: If it is not what its format promises.
        OSError: If it cannot be read.
    """
    if not _is_estimate(path):
        return {"": io.load(path)}, None
    estimate = io.load_estimate(path, trust_pickle=trust_pickle)
    if estimate.frame_rate is None:
        estimate = replace(estimate, frame_rate=frame_rate)
    return {name: estimate.motion(name) for name in estimate.tracks}, estimate


def _is_estimate(path: Path) -> bool:
    """Whether an estimator's file, or an npz of SMPL parameters that is not AMASS's."""
    if path.suffix.lower() in ESTIMATORS:
        return True
    if path.suffix.lower() != ".npz":
        return False
    try:
        with path.open("rb") as stream, zipfile.ZipFile(stream) as archive:
            keys = {name.removesuffix(".npy") for name in archive.namelist()}
    except (ValueError, OSError, EOFError, NotImplementedError, zipfile.BadZipFile):
        return False  # said better where it is read
    in_parts = {"global_orient", "body_pose"} <= keys
    without_rate = "poses" in keys and keys.isdisjoint({"q", *FRAME_RATES})
    return in_parts or without_rate
