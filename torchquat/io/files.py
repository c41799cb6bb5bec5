"""Load and save by file name."""

import os
from pathlib import Path

from torchquat.io._writing import write_whole
from torchquat.io.bvh import BvhSource, new_bvh, read_bvh
from torchquat.io.estimate import TrackSource
from torchquat.io.estimators import load_estimate
from torchquat.io.motion import FormatError, Motion
from torchquat.io.npz import NpzSource, new_npz, read_npz

__all__ = ["FORMATS", "load", "save"]

FORMATS = (".bvh", ".npz")
ESTIMATES = (".pt", ".pkl")


def load(
    path: str | os.PathLike[str],
    *,
    lenient: bool = False,
    track: str | None = None,
    frame_rate: float | None = None,
    trust_pickle: bool = False,
) -> Motion:
    """Read a motion file.

    Args:
        path: A BVH file, an AMASS or SMPL ``.npz``, a plain ``.npz`` of :func:`save`, or an
            estimator's ``.pt`` or ``.pkl``, see :func:`load_estimate`, which reads all its tracks.
        lenient: Accept a BVH file whose ``Frames:`` does not match its rows, with a warning.
        track: Of an estimator's file, which track; needed where it has more than one.
        frame_rate: Of an estimator's file, frames per second, which it does not hold.
        trust_pickle: Of an estimator's file, whether a pickle may be run.

    Returns:
        The rotations, and what :func:`save` needs to write everything else back as it was.

    Raises:
        FormatError: If the content is not what the format promises, with file and line.
        ValueError: If the name has another ending.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() in ESTIMATES:
        estimate = load_estimate(path, frame_rate=frame_rate, trust_pickle=trust_pickle)
        return estimate.motion(track)
    if _format(path) == ".bvh":
        return read_bvh(path, lenient=lenient)
    return read_npz(path)


def save(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion, in the format that it was read from or in another.

    In its own format everything but the rotations comes back as it was read, and the rotations of
    joints that did not change do too. In another, the file is new: BVH needs a skeleton and
    complete rotations; ``.npz`` is plain. An estimator's file is written whole, with this track
    in it; there is no new one. The file appears under its name only when it is complete.

    Args:
        motion: What to write.
        path: File to write; it is replaced if it exists.

    Raises:
        ValueError: If the name has another ending, or the motion lacks what the format needs.
        OSError: If the file cannot be written.
    """
    path = Path(path)
    if isinstance(motion.source, TrackSource) and path.suffix.lower() == motion.source.suffix:
        write_whole(path, motion.source.render(motion))
        return
    if path.suffix.lower() in ESTIMATES:
        raise ValueError(f"{path}: only a motion of such a file can be written to one.")
    kind, new = (BvhSource, new_bvh) if _format(path) == ".bvh" else (NpzSource, new_npz)
    source = motion.source
    write_whole(path, source.render(motion) if isinstance(source, kind) else new(motion))


def _format(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise FormatError(f"{path}: expected a name that ends in {' or '.join(FORMATS)}")
    return suffix
