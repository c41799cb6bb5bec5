"""Clips that the benchmark of quality judges on, and how it spoils them."""

import csv
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from _clips import CMU, middle, moving_joints, synthetic_arm, synthetic_run
from torch import Tensor

from torchquat import io, noise

__all__ = ["CLEAN", "COLUMNS", "FRAMES", "Clip", "corrupted", "dropped", "paths_of", "read"]

FRAMES = {120: 300, 30: 200}
"""Frames taken from every clip, by frame rate."""
SIGMA = 0.008  # [rad], as in Dean's Table I
CLEAN = "clean"

Corrupt = Callable[[Tensor, torch.Generator], Tensor]


def _gaussian(level: float) -> Corrupt:
    return lambda q, generator: noise.gaussian(q, level * SIGMA, generator=generator)


def _per_joint(q: Tensor, generator: torch.Generator) -> Tensor:
    """Every joint has a noise of its own, from 1 to 75 times SIGMA, logarithms evenly spread."""
    spread = torch.rand(q.shape[-2], generator=generator, dtype=q.dtype)
    return noise.gaussian(q, SIGMA * 75.0**spread, generator=generator)


COLUMNS: dict[str, Corrupt] = {
    CLEAN: lambda q, generator: q,
    **{str(level): _gaussian(level) for level in (1, 5, 15, 30, 75)},
    "impulse": lambda q, generator: noise.impulse(q, 0.5, share=0.05, generator=generator),
    "per joint": _per_joint,
    "AR(1)": lambda q, generator: noise.correlated(q, 5 * SIGMA, rho=0.9, generator=generator),
    "pops": lambda q, generator: noise.pops(q, 0.5, share=0.05, generator=generator),
}
"""Kinds of noise: numbers are multiples of 0.008 rad, Gaussian per axis."""


@dataclass(frozen=True)
class Clip:
    """A slice of a motion.

    Attributes:
        name: Of the file.
        q: Unit quaternions ``(T, J, 4)`` of the joints that move.
    """

    name: str
    q: Tensor


def paths_of(folder: Path | None) -> list[Path]:
    """Motion files of a folder; of the shared clips if none is named; none if these are absent.

    Raises:
        ValueError: If a named folder has no BVH file.
    """
    paths = sorted((CMU if folder is None else folder).glob("*.bvh"))
    if folder is not None and not paths:
        raise ValueError(f"clips must be a folder of BVH files, got {folder}.")
    return paths


def read(paths: list[Path], rate: int, frames: int | None, start: int | None) -> list[Clip]:
    """Slices of all clips at one frame rate, in float64; made-up motion for no paths.

    Args:
        paths: Motion files; a manifest.csv beside them may say how many frames to drop.
        rate: Frame rate [1/s]: recordings are thinned out to about this.
        frames: Length at most; ``None``: that of :data:`FRAMES`, or 300.
        start: First frame after the dropped ones, at the given rate; ``None``: from the middle.
    """
    length = FRAMES.get(rate, 300) if frames is None else frames
    if not paths:
        made = {"made-up run": synthetic_run, "made-up arm": synthetic_arm}
        return [Clip(name, make(length, rate).q) for name, make in made.items()]
    clips = []
    for path in paths:
        skip = dropped(path)
        if start is None:
            motion = middle(path, length, frame_rate=rate, skip=skip)
        else:
            motion = _sliced(path, length, rate, skip, start)
        motion = moving_joints(motion)
        if motion.q.shape[-2] > 0:
            clips.append(Clip(path.stem, motion.q.double()))
    return clips


def _sliced(path: Path, frames: int, rate: int, skip: int, start: int) -> io.Motion:
    """As ``middle``, from a given frame on."""
    motion = middle(path, 10**9, frame_rate=rate, skip=skip)
    left = motion.q[start : start + frames]
    if len(left) == 0:
        raise ValueError(f"{path}: start must be < {len(motion.q)}, got {start}.")
    return io.Motion(left, motion.frame_rate, motion.names, skeleton=motion.skeleton)


def dropped(path: Path) -> int:
    """Leading frames that are no motion, as the manifest says."""
    manifest = path.parent / "manifest.csv"
    if not manifest.exists():
        return 0
    with manifest.open(newline="", encoding="utf-8") as lines:
        leading = {row["file"]: int(row["drop_first"]) for row in csv.DictReader(lines)}
    return leading.get(path.name, 0)


def corrupted(clip: Clip, rate: int, columns: list[str], seeds: list[int]) -> Tensor:
    """Noisy versions ``(columns, seeds, T, J, 4)``: a draw depends on nothing but its own names."""
    drawn = [
        torch.stack([_draw(clip, f"{clip.name} {rate} {column} {seed}", column) for seed in seeds])
        for column in columns
    ]
    return torch.stack(drawn)


def _draw(clip: Clip, label: str, column: str) -> Tensor:
    generator = torch.Generator().manual_seed(zlib.crc32(label.encode()))
    return COLUMNS[column](clip.q, generator)
