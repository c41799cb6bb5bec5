"""The wrong ways are wrong in the way that is said, and only there."""

import _competitors as competitors
import _wrong_ways as wrong
import numpy as np
import pytest
import torch
from motions import assert_same_rotation, numpy_of, smooth_motion
from scipy.spatial.transform import Rotation

from torchquat import gaussian_filter, one_euro_filter

WAYS = {
    "components": wrong.components,
    "increments": wrong.integrated_increments,
    "logs": wrong.logs_at_identity,
    "matrices": wrong.nine_entries,
    "vectors": wrong.rotation_vectors,
}


def about_z(angles):
    """Rotations ``(T, 1, 4)`` about one axis."""
    return Rotation.from_euler("z", angles[:, None]).as_quat()[:, None]


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_constant_motion_stays(way, rng):
    q = numpy_of(smooth_motion(frames=1, rng=rng)).repeat(20, axis=0)
    assert_same_rotation(torch.tensor(way(q)), torch.tensor(q), 1e-7)


def test_small_turns_about_one_axis_come_out_right():
    """There the rotation vector is the angle, and all charts are one."""
    angles = 0.3 * np.sin(0.2 * np.arange(40.0)) + 0.02 * np.cos(2.0 * np.arange(40.0))
    q = about_z(angles)
    ours = gaussian_filter(torch.tensor(q), sigma_t=1.5, radius=6)[6:-6]
    assert_same_rotation(torch.tensor(wrong.logs_at_identity(q, 1.5))[6:-6], ours, 1e-6)
    euro = one_euro_filter(torch.tensor(q), min_cutoff=0.05, beta=0.4)
    assert_same_rotation(torch.tensor(wrong.rotation_vectors(q, 0.05, 0.4)), euro, 1e-9)


def test_rotation_vectors_break_where_the_angle_passes_pi():
    """A steady turn through pi: components and increments follow, logarithms do not."""
    q = about_z(np.pi + 0.02 * np.arange(-20.0, 21.0))
    error = {}
    for name in ("logs", "components", "increments"):
        made = Rotation.from_quat(WAYS[name](q)[:, 0])
        error[name] = (made.inv() * Rotation.from_quat(q[:, 0])).magnitude()[15:26].max()
    assert error["logs"] > 1.0 and error["components"] < 1e-3 and error["increments"] < 1e-6


def test_integrated_increments_drift():
    """A turn there and back about changing axes does not come back."""
    generator = np.random.default_rng(0)
    steps = Rotation.from_rotvec(0.3 * generator.standard_normal((200, 3)))
    walk = [Rotation.identity()]
    for step in steps:
        walk.append(walk[-1] * step)
    q = np.stack([place.as_quat() for place in walk])[:, None]
    made = Rotation.from_quat(wrong.integrated_increments(q, 2.0)[-1, 0])
    kept = gaussian_filter(torch.tensor(q), sigma_t=2.0)[-1, 0]
    assert (made.inv() * walk[-1]).magnitude() > 0.5
    assert (Rotation.from_quat(kept.numpy()).inv() * walk[-1]).magnitude() < 1.0


def test_matrices_that_become_mirrors_are_made_rotations(rng):
    q = numpy_of(smooth_motion(frames=60, step=2.0, rng=rng))
    entries = competitors.smooth_matrices(q, 8)
    assert (np.linalg.det(entries) < 0).any()
    assert np.allclose(np.linalg.norm(wrong.nine_entries(q, 8), axis=-1), 1.0)
    # without noise to speak of, it is what the competitor in speed does
    slow = numpy_of(smooth_motion(frames=30, step=0.1, rng=rng))
    same = torch.tensor(competitors.nine_entries(slow))
    assert_same_rotation(torch.tensor(wrong.nine_entries(slow)), same, 1e-7)


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_matrices_of_sequences_shorter_than_the_window(frames, rng):
    q = numpy_of(smooth_motion(frames=frames, rng=rng))
    assert wrong.nine_entries(q, 8).shape == q.shape
