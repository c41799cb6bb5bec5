"""A record of a batch: one line of JSON for every file, written as soon as its fate is known."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["Manifest", "read_manifest"]


class Manifest:
    """Lines at the end of a file; what earlier runs wrote stays.

    Args:
        path: File of JSON lines, made with its folder where it does not exist.

    Raises:
        OSError: If it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("ab")
        if not _ends_with_a_line(path):  # a run was killed while it wrote
            self._file.write(b"\n")

    def write(self, record: Mapping[str, Any]) -> None:
        """Add a line; it is on the disk when this returns."""
        # escapes, as a name on a disk may be no text in any encoding
        self._file.write(json.dumps(record).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """No more lines."""
        self._file.close()

    def __enter__(self) -> "Manifest":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_manifest(path: Path) -> list[dict[str, Any]]:
    """All whole lines of a manifest; none where there is no file.

    Raises:
        OSError: If it cannot be read.
    """
    if not path.exists():
        return []
    records = []
    for line in path.read_text(encoding="utf-8", errors="replace").split("\n"):
        try:
            record = json.loads(line)
        except ValueError:  # half a line of a run that was killed
            continue
        if isinstance(record, dict):
            records.append(record)
    return records


def _ends_with_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read() == b"\n"
