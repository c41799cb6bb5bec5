"""Smooth motions near noisy ones, against loops."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
import reference_spectra
import torch
from motions import assert_same_rotation, numpy_of, smooth_motion

from torchquat import noise
from torchquat.filters._moving_frame import rough_motion


@pytest.mark.parametrize("frames", [1, 3, 9, 30])
def test_rough_motion_agrees_with_the_loop(frames, rng):
    q = noise.gaussian(smooth_motion(frames=frames, rng=rng, step=0.2), 0.1, generator=rng)
    expected = np.stack([reference_spectra.rough_motion(numpy_of(q[:, j]), 4) for j in range(3)], 1)
    assert_same_rotation(rough_motion(q, 4), torch.from_numpy(expected), 1e-6)


@pytest.mark.parametrize("axes", list(combinations_with_replacement(range(4), 2)), ids=str)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rotations_on_an_axis_or_between_two_stay(axes, side, dtype):
    """No sum of products but that of all squares is safe."""
    q = torch.zeros(12, 1, 4, dtype=dtype)
    q[..., axes[0]] = 1.0
    q[..., axes[1]] = side
    q = q / q.norm(dim=-1, keepdim=True)
    assert_same_rotation(rough_motion(q, 4), q)
