"""The way that compilers and GPUs go, where no value is looked at, leads to the same place."""

import pytest
import torch
from filters_under_test import ALL
from motions import assert_same_rotation, random_rotations, smooth_motion

from torchquat import _blocks
from torchquat.filters import _hankel, _local_spectra, _outliers


@pytest.fixture
def unseen(monkeypatch):
    """From here on nothing may be looked at, as while a compiler traces."""
    return lambda: monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)


def motions(rng):
    """Plain, rough with jumps, with gaps and half turns; each with and without weights."""
    q = smooth_motion(2, frames=33, rng=rng)
    rough = q.clone()
    rough[:, ::7] = random_rotations(2, 5, 3, rng=rng)
    rough[0, 12:14, 1] = -rough[0, 10:12, 1]
    gaps = q.clone()
    gaps[0, 3:9, 1] = torch.nan
    gaps[1, 20:, 0] = 0.0
    gaps[1, :2, 2] = torch.inf
    weight = torch.rand(2, 33, 3, generator=rng, dtype=q.dtype)
    weight[0, 25:30] = 0.0
    return [(each, w) for each in (q, rough, gaps) for w in (None, weight)]


@pytest.mark.parametrize("name", ALL)
def test_every_filter(name, rng, unseen):
    run, tried = ALL[name], motions(rng)
    expected = [run(*each) for each in tried]
    unseen()
    for each, wanted in zip(tried, expected, strict=True):
        with torch.device("meta"):  # B11: nothing is made on the default device
            found = run(*each)
        assert_same_rotation(found, wanted, 1e-10)


@pytest.mark.parametrize("name", ["auto", "local-spectrum", "local-spectrum-short", "low-rank"])
@pytest.mark.parametrize("size", [1, 500])
def test_parts_of_any_size(name, size, rng, monkeypatch):
    """How much is done at a time is a matter of speed alone."""
    run, tried = ALL[name], motions(rng)
    expected = [run(*each) for each in tried]
    for module, known in (
        (_blocks, "BLOCK"),
        (_hankel, "AT_A_TIME"),
        (_local_spectra, "AT_A_TIME"),
        (_outliers, "BLOCK"),
    ):
        monkeypatch.setattr(module, known, size)
    for each, wanted in zip(tried, expected, strict=True):
        assert_same_rotation(run(*each), wanted, 1e-10)
