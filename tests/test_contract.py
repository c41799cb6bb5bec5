"""Every filter of the package holds every invariance; names carry the rows of the contract."""

import invariances
import pytest
import torch
from filters_under_test import every_filter
from motions import angle_between, random_rotations, smooth_motion

from torchquat import BilateralFilter, GaussianFilter


@pytest.fixture
def q(rng, dtype):
    return smooth_motion(frames=13, step=0.4, rng=rng, dtype=dtype)


def test_A3_sign_flips(run, q, rng):
    invariances.check_sign_flips(run, q, rng)


def test_A4_alternating_signs(run, rng):
    invariances.check_alternating_signs(run, rng)


def test_A13_scaled_input_B13_is_not_written_to(run, q):
    invariances.check_scale_and_input_untouched(run, q)


def test_A14_a_missing_frame_stays_alone(run, q):
    invariances.check_missing_frame_stays_alone(run, q)


def test_A14_a_missing_frame_has_no_gradient(run, q):
    invariances.check_missing_frame_has_no_gradient(run, q)


def test_A20_constant_motion(run, rng, dtype):
    invariances.check_constant_motion(run, rng, dtype)


def test_A19_B19_batch_does_not_mix(run, rng, dtype):
    invariances.check_batch_does_not_mix(run, smooth_motion(3, frames=9, rng=rng, dtype=dtype))


def test_B18_unit_output_the_same_twice(run, q):
    invariances.check_output(run, q)


def test_C8_commutes_with_every_rotation_of_the_3_sphere(run, q, rng):
    invariances.check_commutes_with_rotations(run, q, rng)


@every_filter("joints")
def test_joints_do_not_mix(run, q, rng):
    invariances.check_joints_do_not_mix(run, q, rng)
    invariances.check_missing_frame_leaves_other_joints(run, q)


@every_filter("C9")
def test_C9_time_reversal(run, q):
    invariances.check_time_reversal(run, q)


@every_filter("ahead")
def test_causal_filters_do_not_look_ahead(run, rng):
    q = smooth_motion(frames=12, rng=rng)
    q[4] = random_rotations(3, rng=rng)  # something to repair
    invariances.check_does_not_look_ahead(run, q, rng)


@pytest.mark.parametrize("name", ["gaussian", "bilateral"])
def test_C8_known_limit_reflections_of_the_3_sphere(name, rng):
    """Exchanged components turn body-frame increments into world-frame ones: they add up otherwise.

    On a path about one axis the order does not matter and nothing deviates; on steps of 0.2 rad in
    random directions the deviation is small against the step, but not rounding.
    """
    run = {"gaussian": GaussianFilter(1.0), "bilateral": BilateralFilter(1.0, 0.5)}[name]
    swap = [1, 0, 2, 3]
    rough = smooth_motion(frames=60, step=0.2, rng=rng)
    deviation = angle_between(run(rough[..., swap]), run(rough)[..., swap])
    assert 1e-6 < deviation.max() < 0.05, f"{deviation.max():.2e} rad"

    angle = torch.linspace(0.0, 2.0, 30, dtype=torch.float64).square()[:, None]
    one_axis = torch.stack([angle.sin(), 0 * angle, 0 * angle, angle.cos()], -1)
    deviation = angle_between(run(one_axis[..., swap]), run(one_axis)[..., swap])
    assert deviation.max() < 1e-12
