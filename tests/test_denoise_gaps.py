"""The command line where parts of a motion are missing: what comes out is complete."""

import denoise
import numpy as np
import pytest
import torch
from motions import random_rotations

from torchquat import io

IDENTITY = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)
LINE = np.linspace(0.0, 29.0, 30)[:, None] * [1.0, -2.0, 0.5]
"""Positions of a root that goes straight on."""


def run(*arguments) -> int:
    return denoise.main([*(str(each) for each in arguments), "--config", "gentle"])


@pytest.fixture
def written(tmp_path, rng):
    """Write a plain npz of two joints with parts replaced; returns its path."""

    def write(q=None, **more):
        q = random_rotations(30, 2, rng=rng).numpy() if q is None else q
        body = {"names": ["a", "b"], "parents": [-1, 0], "offsets": np.ones((2, 3))}
        np.savez(tmp_path / "in.npz", q=q, order="xyzw", frame_rate=30.0, **body, **more)
        return tmp_path / "in.npz"

    return write


def test_a_root_that_is_missing_for_a_while(written, tmp_path, capsys):
    """Its place is on the way from the last to the next; ends are held, the rest is as it was."""
    q, root = random_rotations(30, 2, rng=torch.Generator().manual_seed(1)).numpy(), LINE.copy()
    q[5:8], root[5:8], root[28:] = np.nan, np.nan, np.inf
    assert run(written(q, root_position=root), "--output", tmp_path / "out.bvh") == 0
    found = io.load(tmp_path / "out.bvh").root_position.numpy()
    assert np.allclose(found[:28], LINE[:28], atol=1e-6)
    assert np.allclose(found[28:], LINE[27], atol=1e-6)
    capsys.readouterr()


def test_a_root_that_is_nowhere_is_not_written_to_bvh(written, tmp_path, capsys):
    path = written(root_position=np.full((30, 3), np.nan))
    assert run(path, "--output", tmp_path / "out.bvh") == 1
    assert "root_position must hold no missing position" in capsys.readouterr().err
    assert not (tmp_path / "out.bvh").exists()
    assert run(path, "--output", tmp_path / "out.npz") == 0
    assert io.load(tmp_path / "out.npz").root_position.isnan().all()


@pytest.mark.parametrize("weight", [None, np.ones((30, 2))])
def test_A11_a_joint_of_zeros_throughout(weight, written, tmp_path, capsys):
    """It never moves, but there is nothing to keep: it is filled, as the line says."""
    q = random_rotations(30, 2, rng=torch.Generator().manual_seed(1)).numpy()
    q[:, 1] = 0.0
    more = {} if weight is None else {"weight": weight}
    for name in ("out.npz", "out.bvh"):
        assert run(written(q, **more), "--output", tmp_path / name) == 0
        found = io.load(tmp_path / name)
        assert found.valid.all() and torch.equal(found.q[:, 1], IDENTITY.expand(30, 4))
        assert "30 of 60 joint samples missing (0 whole frames), filled" in capsys.readouterr().out
