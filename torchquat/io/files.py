"""Load and save by file name."""

import os
import tempfile
from pathlib import Path

from torchquat.io.bvh import BvhSource, new_bvh, read_bvh
from torchquat.io.motion import FormatError, Motion
from torchquat.io.npz import NpzSource, new_npz, read_npz

__all__ = ["FORMATS", "load", "save"]

FORMATS = (".bvh", ".npz")


def load(path: str | os.PathLike[str], *, lenient: bool = False) -> Motion:
    """Read a motion file.

    Args:
        path: A BVH file, an AMASS or SMPL ``.npz``, or a plain ``.npz`` of :func:`save`.
        lenient: Accept a BVH file whose ``Frames:`` does not match its rows, with a warning.

    Returns:
        The rotations, and what :func:`save` needs to write everything else back as it was.

    Raises:
        FormatError: If the content is not what the format promises, with file and line.
        ValueError: If the name has another ending.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    if _format(path) == ".bvh":
        return read_bvh(path, lenient=lenient)
    return read_npz(path)


def save(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion, in the format that it was read from or in another.

    In its own format everything but the rotations comes back as it was read, and the rotations of
    joints that did not change do too. In another, the file is new: BVH needs a skeleton and
    complete rotations; ``.npz`` is plain. The file appears under its name only when it is complete.

    Args:
        motion: What to write.
        path: File to write; it is replaced if it exists.

    Raises:
        ValueError: If the name has another ending, or the motion lacks what the format needs.
        OSError: If the file cannot be written.
    """
    path = Path(path)
    kind, new = (BvhSource, new_bvh) if _format(path) == ".bvh" else (NpzSource, new_npz)
    source = motion.source
    _write(path, source.render(motion) if isinstance(source, kind) else new(motion))


def _format(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise FormatError(f"{path}: expected a name that ends in {' or '.join(FORMATS)}")
    return suffix


def _write(path: Path, content: bytes) -> None:
    """Write to a temporary file beside ``path``, then rename: no reader sees half a file."""
    target = path.resolve()
    handle, name = tempfile.mkstemp(prefix=".torchquat-", suffix=".tmp", dir=target.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            temporary.chmod(target.stat().st_mode & 0o777)
        else:
            mask = os.umask(0)
            os.umask(mask)
            temporary.chmod(0o666 & ~mask)
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
