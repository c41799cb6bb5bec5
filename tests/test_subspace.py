"""Principal and kernel components of poses, against NumPy and loops."""

import numpy as np
import pytest
import reference_competitors as oracle
import torch
from motions import assert_same_rotation, numpy_of, random_rotations, smooth_motion

from torchquat import KernelPCAFilter, PrincipalComponentFilter
from torchquat.filters._chart import Chart
from torchquat.filters._spectra import leading, of_eigenvalues
from torchquat.filters.subspace import _mean, _squared_width


@pytest.mark.parametrize("components", [1, 3, 0.7])
def test_principal_components_are_those_of_numpy(components, rng):
    q = smooth_motion(frames=15, rng=rng)
    weight = torch.rand(15, 3, generator=rng, dtype=q.dtype)
    weight[4:7, 1] = 0.0
    for trust in (None, weight):
        known = np.ones((15, 3)) if trust is None else numpy_of(trust)
        expected = oracle.principal_components(numpy_of(q), known, components)
        actual = PrincipalComponentFilter(components)(q, trust)
        assert_same_rotation(actual, torch.from_numpy(expected), 1e-6)


def test_all_components_together_are_the_motion(rng):
    """Also where rotations lie so far apart that their mean is not found to the last digit."""
    q = random_rotations(30, 2, rng=rng)
    assert_same_rotation(PrincipalComponentFilter(6)(q), q)


@pytest.mark.parametrize(
    ("apart", "slope"),
    [(1e-3, 1e3), (1e-12, 1e-12 * 2.0**52), (1e-15, 1e-15 * 2.0**52), (0.0, 0.0)],
)
def test_directions_cut_apart_may_turn_no_faster_than_rounding_allows(apart, slope):
    """What a projection changes by is 1 over how far the eigenvalues lie apart, until they meet."""
    eigenvalues = torch.tensor([0.5, 1.0 - apart, 1.0], dtype=torch.float64)
    matrix = torch.diag(eigenvalues).requires_grad_()
    kept = leading(eigenvalues, 1)
    projection = of_eigenvalues(matrix, (eigenvalues, torch.eye(3).double()), kept)
    assert torch.equal(projection.detach(), torch.diag(torch.tensor([0.0, 0.0, 1.0]).double()))
    (found,) = torch.autograd.grad(projection[1, 2], matrix)
    assert float(found[1, 2]) == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize(("components", "sigma"), [(1, 0.8), (4, 0.4)])
def test_kernel_components_and_pre_images_are_those_of_the_loop(components, sigma, rng):
    q = smooth_motion(frames=15, rng=rng)
    expected = oracle.kernel_pca(numpy_of(q), components, sigma, 5)
    actual = KernelPCAFilter(components, sigma=sigma, iterations=5)(q)
    assert_same_rotation(actual, torch.from_numpy(expected), 1e-6)


@pytest.mark.parametrize("sigma", [0.5, 0.05])
def test_anchors_are_the_middles_of_equal_stretches(sigma, rng):
    """Poses far from all of them come to the nearest; the kernel is next to nothing there."""
    q = smooth_motion(frames=15, rng=rng)
    expected = oracle.kernel_pca(numpy_of(q), 4, sigma, 5, [1, 4, 7, 10, 13])
    actual = KernelPCAFilter(4, sigma=sigma, iterations=5, landmarks=5)(q)
    assert_same_rotation(actual, torch.from_numpy(expected), 1e-6)


def test_the_kernel_is_as_wide_as_poses_lie_apart(rng):
    q = smooth_motion(frames=15, rng=rng)
    points, _, _ = oracle.poses(numpy_of(q), np.ones((15, 3)))
    apart = points[:, None] - points[None]
    width = float(np.sqrt(np.mean(np.square(apart))))
    expected = KernelPCAFilter(2, sigma=width)(q)
    assert_same_rotation(KernelPCAFilter(2)(q), expected, 1e-9)


def test_joints_that_are_missing_throughout_make_no_difference_to_the_others(rng):
    """Not even where so few are seen that all frames together count for less than one."""
    q = smooth_motion(frames=3, joints=1, rng=rng)
    alone = KernelPCAFilter(1, sigma=0.8)(q)
    among = q.expand(3, 8, 4)
    weight = torch.zeros(3, 8, dtype=q.dtype)
    weight[:, 2] = 1.0
    # the width of the kernel is that of a whole pose
    found = KernelPCAFilter(1, sigma=0.8 / 8**0.5)(among, weight)
    assert_same_rotation(found[:, 2:3], alone, 1e-9)


def test_mean_pose_and_width_are_those_of_every_axis(rng):
    points, trust = (torch.rand(2, 2, 5, 6, generator=rng) + 0.1).double().unbind(0)
    chart, weights = Chart(points, trust, points[..., :4]), numpy_of(trust)
    expected = np.average(numpy_of(points), axis=1, weights=weights)
    found = _mean(chart)
    assert np.allclose(found[:, 0].numpy(), expected, atol=1e-12) and found.shape == (2, 1, 6)
    square = np.square(numpy_of(points) - expected[:, None])
    wide = 12.0 * np.average(square, axis=(1, 2), weights=weights)
    assert np.allclose(_squared_width(chart, None).flatten().numpy(), wide, atol=1e-12)


@pytest.mark.parametrize("run", [PrincipalComponentFilter(2), KernelPCAFilter(2, sigma=0.5)])
def test_confidences_are_relative(run, rng):
    """Of rotations all over as well, whose mean is not found to the digit."""
    for q in (smooth_motion(frames=15, rng=rng), random_rotations(15, 3, rng=rng)):
        weight = torch.rand(15, 3, generator=rng, dtype=q.dtype)
        assert_same_rotation(run(q, 1e-3 * weight), run(q, weight), 1e-9)


def test_a_missing_pose_leaves_derivatives_by_weights_finite(rng):
    q = smooth_motion(frames=9, rng=rng)
    weight = torch.rand(9, 3, generator=rng, dtype=q.dtype) + 0.5
    weight[4] = 0.0
    run = KernelPCAFilter(2, sigma=0.5)
    total = (run(q, weight.requires_grad_())[0] * q[1]).sum()
    (slope,) = torch.autograd.grad(total, weight)
    step = torch.zeros_like(weight).index_put(
        (torch.tensor(2), torch.tensor(1)), weight.new_tensor(1e-6)
    )
    ends = [(run(q, weight.detach() + sign * step)[0] * q[1]).sum() for sign in (1, -1)]
    assert slope.isfinite().all() and slope[2, 1] != 0
    assert torch.allclose(slope[2, 1], (ends[0] - ends[1]) / 2e-6, rtol=1e-5)


def test_more_components_than_there_are_kinds_of_poses(rng):
    """Two poses in turn: all but one eigenvalue are rounding, and are not divided by."""
    q = smooth_motion(frames=2, rng=rng).repeat(4, 1, 1)
    assert_same_rotation(KernelPCAFilter(4, sigma=0.5)(q), q, 1e-9)
