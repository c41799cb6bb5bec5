"""Folders of generated motion files."""

from pathlib import Path

import numpy as np
from bvh_files import one_joint


def write_archive(folder: Path, files: int, frames: int = 20) -> None:
    """Files in several folders; the one numbered 1 has 13 frames."""
    rng = np.random.default_rng(0)
    for number in range(files):
        place = folder / f"take {number % 5}"
        place.mkdir(parents=True, exist_ok=True)
        rows = rng.normal(0, 5, (13 if number == 1 else frames, 3)).tolist()
        (place / f"{number}.bvh").write_text(one_joint(*rows))


def contents(folder: Path) -> dict[str, bytes]:
    """All motion files of a folder by their places in it."""
    found = sorted(folder.rglob("*.bvh"))
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}
