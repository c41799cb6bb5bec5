"""Files of pose estimators in tests: written, read as their own programs do, compared."""

from pathlib import Path
from typing import Any

import make_estimates as made
import numpy as np
import pytest
import torch

from torchquat import io, so3

NEEDS_JOBLIB = "joblib is not installed (extra: estimators)"

CASES = {
    "GVHMR": ("hmr4d_results.pt", made.gvhmr, {}),
    "WHAM": ("wham_output.pkl", made.wham, {}),
    "PHALP": ("demo_clip.pkl", made.phalp, {"compress": 3}),
    "SMPL": ("smpl.npz", made.smpl, {}),
    "AMASS": ("amass.npz", made.amass, {}),
}


class Bomb:
    """Unpickled, it would write a file."""

    def __reduce__(self):
        return (open, ("exploded", "w"))


def write(path: Path, tree: Any, **options: Any) -> Path:
    if path.suffix == ".pt":
        torch.save(tree, path)
    elif path.suffix == ".npz":
        np.savez(path, **tree)
    else:
        pytest.importorskip("joblib", reason=NEEDS_JOBLIB).dump(tree, path, **options)
    return path


def tree_of(path: Path) -> Any:
    """A file as its own program reads it."""
    if path.suffix == ".pt":
        return torch.load(path, weights_only=True)
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {key: file[key] for key in file.files}
    return pytest.importorskip("joblib", reason=NEEDS_JOBLIB).load(path)


def load(path: Path, **options: Any) -> io.Estimate:
    return io.load_estimate(path, **{"frame_rate": 30.0, "trust_pickle": True} | options)


def changed(before: Any, after: Any, path: tuple[Any, ...] = ()) -> set[tuple[Any, ...]]:
    """Paths of the leaves that differ; containers, kinds, dtypes, shapes and order must not."""
    assert type(after) is type(before), path
    if isinstance(before, dict):
        assert list(after) == list(before), path
        pairs = [(key, before[key], after[key]) for key in before]
    elif isinstance(before, list):
        assert len(after) == len(before), path
        pairs = [(i, *pair) for i, pair in enumerate(zip(before, after, strict=True))]
    elif isinstance(before, np.ndarray | torch.Tensor):
        assert before.dtype == after.dtype and before.shape == after.shape, path
        return set() if bool((before == after).all()) else {path}
    else:
        return set() if before == after else {path}
    return {leaf for key, a, b in pairs for leaf in changed(a, b, (*path, key))}


def turned(estimate: io.Estimate) -> io.Estimate:
    turn = so3.exp(torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    return estimate.with_rotations(
        {name: so3.compose(track.q, turn) for name, track in estimate.tracks.items()}
    )
