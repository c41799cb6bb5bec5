"""Files that appear whole or not at all."""

import os
import socket
import tempfile
from pathlib import Path

__all__ = ["PATTERN", "write_whole", "writer_of"]

PATTERN = ".torchquat-*.tmp"
"""Names of temporary files."""


def write_whole(path: Path, content: bytes) -> None:
    """Write to a temporary file beside ``path``, then rename: no reader sees half a file."""
    target = path.resolve()
    prefix = f".torchquat-{os.getpid()}-{socket.gethostname()}-"
    handle, name = tempfile.mkstemp(prefix=prefix, suffix=".tmp", dir=target.parent)
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
        _settle(target.parent)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def writer_of(temporary: Path) -> tuple[int, str] | None:
    """Process and machine that write a temporary file, by its name."""
    parts = temporary.name.split("-", 2)
    if len(parts) < 3 or not parts[1].isdigit():
        return None
    return int(parts[1]), parts[2].rpartition("-")[0]


def _settle(folder: Path) -> None:
    """See that a name is on the disk, too."""
    if os.name != "posix":  # elsewhere folders cannot be opened
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
