"""Temporary files of processes that were killed while they wrote."""

import os
import socket
from pathlib import Path

from torchquat.io._writing import PATTERN, writer_of

__all__ = ["sweep"]


def sweep(folder: Path) -> None:
    """Remove what processes of this machine left behind that no longer run."""
    if os.name != "posix":  # elsewhere signal 0 is not a question
        return
    for path in folder.rglob(PATTERN):
        writer = writer_of(path)
        if writer is not None and writer[1] == socket.gethostname() and not _runs(writer[0]):
            path.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it is somebody else's
        return True
    return True
