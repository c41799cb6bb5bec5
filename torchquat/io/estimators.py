"""Files of pose estimators: GVHMR, WHAM, PHALP and 4D-Humans, and npz of SMPL parameters."""

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchquat.io import _amass, _gvhmr, _phalp, _wham
from torchquat.io._trees import JoblibFile, NpzFile, TorchFile, TreeFile, keys_of
from torchquat.io._writing import write_whole
from torchquat.io._zip import Archive
from torchquat.io.estimate import Estimate, EstimateSource, Layout, Track
from torchquat.io.motion import FormatError

__all__ = ["ESTIMATES", "load_estimate", "save_estimate"]

ESTIMATES = (".pt", ".pkl", ".npz")

Found = Mapping[str, tuple[Layout, Track]]


def load_estimate(
    path: str | os.PathLike[str], *, frame_rate: float | None = None, trust_pickle: bool = False
) -> Estimate:
    """Read what a pose estimator wrote.

    =================  ==========================================================================
    GVHMR              ``hmr4d_results.pt``: tracks ``smpl_params_global``, ``smpl_params_incam``
    WHAM               ``wham_output.pkl``: ``ID/pose``, ``ID/pose_world`` for each person
    PHALP, 4D-Humans   ``results/*.pkl``: ``ID`` for each person
    SMPL, AMASS        ``*.npz``: ``poses``, or ``smpl`` where ``global_orient`` and ``body_pose``
                       are apart
    =================  ==========================================================================

    A frame between a person's first and last in which it was not observed is missing: it has
    weight 0. Of WHAM these are gaps in ``frame_ids``, of PHALP frames in which the person was not
    detected but predicted (``tracked_time`` other than 0).

    Args:
        path: File to read.
        frame_rate: Frames per second. Only npz files hold their own, which this overrides.
        trust_pickle: WHAM and PHALP write pickles, and reading one runs whatever its author put
            into it: only for files that you made yourself. Needs ``torchquat[estimators]``.

    Returns:
        All tracks, and what :func:`save_estimate` needs to write everything else back as it was.

    Raises:
        FormatError: If the content is not what an estimator writes, or is a pickle not trusted.
        ImportError: If joblib is needed and not installed.
        ValueError: If the frame rate is not one.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    if frame_rate is not None and not 0 < frame_rate < math.inf:
        raise ValueError(f"frame_rate must be finite and > 0, got {frame_rate}.")
    suffix = path.suffix.lower()
    file: TreeFile
    if suffix == ".pt":
        file = TorchFile.read(path)
        producer, found = "GVHMR", _gvhmr.find(path, file.tree)
    elif suffix == ".pkl":
        file = JoblibFile.read(path, trust_pickle=trust_pickle)
        producer, found = _find_pickled(path, file.tree)
    elif suffix == ".npz":
        file = NpzFile(Archive(path))
        tree = file.tree
        producer, found = "SMPL", _amass.find(path, tree)
        frame_rate = frame_rate or _amass.frame_rate(path, tree)
    else:
        raise FormatError(f"{path}: expected a name that ends in {', '.join(ESTIMATES)}")
    tracks = {name: track for name, (_, track) in found.items()}
    layouts = {name: layout for name, (layout, _) in found.items()}
    return Estimate(producer, tracks, frame_rate, EstimateSource(path, file, layouts, tracks))


def save_estimate(estimate: Estimate, path: str | os.PathLike[str]) -> None:
    """Write an estimate in the format that it was read from.

    Keys, their order, containers, dtypes and shapes are those of the file read, and so are all
    numbers but rotations, and translations where they were changed. What the estimator computed
    from the rotations stays what it was: vertices (``verts`` of WHAM), joints, renderings.

    Args:
        estimate: What to write.
        path: File to write; it is replaced if it exists, when the new one is complete.

    Raises:
        ValueError: If the name ends otherwise than that of the file read.
        OSError: If the file cannot be written.
    """
    path, suffix = Path(path), estimate.source.path.suffix.lower()
    if path.suffix.lower() != suffix:
        raise FormatError(f"{path}: expected a name that ends in {suffix}, as the file read")
    write_whole(path, estimate.render())


def _find_pickled(path: Path, tree: Any) -> tuple[str, Found]:
    """Who wrote a pickle, by what it holds."""
    if isinstance(tree, Mapping) and tree:
        first = next(iter(tree.values()))
        if _wham.looks_like(first):
            return "WHAM", _wham.find(path, tree)
        if _phalp.looks_like(first):
            return "PHALP", _phalp.find(path, tree)
        raise FormatError(
            f"{path}: expected people with the keys {list(_wham.KEYS)} (WHAM) or frames with "
            f"{list(_phalp.KEYS)} (PHALP), got {keys_of(first)} in {next(iter(tree))!r}"
        )
    raise FormatError(f"{path}: expected a mapping of people or frames, got {keys_of(tree)}")
