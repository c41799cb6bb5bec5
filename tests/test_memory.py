"""How much memory a filter takes, in a process of its own."""

import sys

import numpy as np
import pytest
import torch
from benchmark_memory import FILTERS, measure, smooth_noisy


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
@pytest.mark.parametrize("name", ["non-local, pose", "bilateral, radius 10"])
def test_B20_memory_of_20000_frames_is_bounded(name, tmp_path):
    """Twelve times the input, where all pairs of frames would take 35.8 GiB."""
    assert name in FILTERS
    q = smooth_noisy(20_000, 24, torch.float32)
    np.save(tmp_path / "q.npy", q.numpy())
    assert measure(name, tmp_path / "q.npy") < 12 * q.nbytes
