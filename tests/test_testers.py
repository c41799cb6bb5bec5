"""Testers are tested: each is seen to fail on a filter with a fault planted in it."""

import invariances
import numpy as np
import pytest
import reference
import torch
from motions import assert_same_rotation, numpy_of, random_rotations, smooth_motion

from torchquat import LiftingTransform, bilateral_filter, gaussian_filter, scale_details, so3


def good(q, weight=None):
    return bilateral_filter(q, weight, sigma_t=1.0, sigma_g=0.5)


def step_of(q, weight=None):
    """The move that the good filter makes, in the body frame."""
    return so3.log(so3.relative(so3.normalize(q), good(q, weight)))


def swapped_product(q, weight=None):
    return so3.compose(so3.exp(step_of(q, weight)), so3.normalize(q))


def half_angle(q, weight=None):
    return so3.compose(so3.normalize(q), so3.exp(0.5 * step_of(q, weight)))


def plus_sign_of_b_r(q, weight=None):
    ones = np.ones(q.shape[:-1])
    options = {"sigma_t": 1.0, "sigma_g": 0.5, "radius": 3, "printed_sign": True}
    return torch.from_numpy(
        reference.every_joint(reference.bilateral_filter, numpy_of(q), ones, **options)
    )


def component_mean(q, weight=None):
    """Neighbours averaged in R^4 without a look at their signs: the short and the long arc."""
    return so3.normalize(q.roll(1, -3) + q)


def long_arc(q, weight=None):
    """Increments by the quaternion's own logarithm: past a sign flip they go the long way round."""
    relative = so3.compose(so3.inverse(q[..., :-1, :, :]), q[..., 1:, :, :])
    angle = 2 * torch.atan2(relative[..., :3].norm(dim=-1), relative[..., 3])[..., None]
    step = angle * torch.nn.functional.normalize(relative[..., :3], dim=-1)
    return torch.cat([so3.compose(q[..., :-1, :, :], so3.exp(step / 4)), q[..., -1:, :, :]], -3)


def towards_the_first_axis(q, weight=None):
    """Not equivariant: its mean is taken of rotation vectors at the identity."""
    v = so3.log(so3.normalize(q))
    return so3.exp((v.roll(1, -3) + v + v.roll(-1, -3)) / 3)


def world_axes(q, weight=None):
    """Turns with the body from the right, not from the left: x is filtered more than y and z."""
    return so3.compose(so3.normalize(q), so3.exp(step_of(q) * q.new_tensor([1.0, 0.5, 0.5])))


def joint_mixer(q, weight=None):
    return so3.slerp(good(q), good(q).roll(1, -2), 0.1)


def batch_mixer(q, weight=None):
    return good(q) if q.dim() == 3 else so3.slerp(good(q), good(q).roll(1, 0), 0.1)


def nan_spreader(q, weight=None):
    return so3.normalize(q) + 0 * q.sum(-3, keepdim=True)


def softmax_spreader(q, weight=None):
    """A missing frame is left out of the mean, but not of the softmax over its window."""
    unit = so3.normalize(q)
    near = unit.unfold(-3, 3, 1).movedim(-1, 0)
    known = near.isfinite().all(-1)
    logits = torch.where(known, 0.0, q.unfold(-3, 3, 1).movedim(-1, 0).sum(-1) * 0.0)
    m = torch.softmax(logits, 0)[..., None]
    inner = so3.normalize((m * so3.align(near, near[1:2])).sum(0))
    return torch.cat([unit[..., :1, :, :], inner, unit[..., -1:, :, :]], -3)


class DropsTheLastFrame(LiftingTransform):
    """Where the number of frames is odd."""

    def inverse(self, pyramid):
        q = super().inverse(pyramid)
        return q[..., : q.shape[-3] // 2 * 2, :, :]


class HalvesDetails(LiftingTransform):
    """A transform that denoises a little."""

    def inverse(self, pyramid):
        return super().inverse(scale_details(pyramid, [0.5] * len(pyramid.details)))


def gap_keeper(q, weight=None):
    """A missing frame is read as the identity."""
    return gaussian_filter(so3.normalize(q), sigma_t=1.0)


def one_sided(q, weight=None):
    return gaussian_filter(q, weight, sigma_t=1.0, causal=True)


def drifter(q, weight=None):
    return so3.compose(good(q), so3.exp(q.new_tensor([1e-4, 0.0, 0.0])))


def writer(q, weight=None):
    result = good(q)
    with torch.no_grad():
        q.div_(q.norm(dim=-1, keepdim=True))
    return result


def unnormalised(q, weight=None):
    return 2.0 * good(q)


def dice(q, weight=None):
    return so3.compose(good(q), so3.exp(1e-6 * torch.randn_like(q[..., :3])))


def outer_hemisphere(q, weight=None):
    return -good(q)


@pytest.fixture
def q(rng):
    return smooth_motion(frames=13, step=0.4, rng=rng)


FAULTS = [
    (invariances.check_sign_flips, component_mean),
    (invariances.check_sign_flips, long_arc),
    (invariances.check_sign_flips, outer_hemisphere),
    (invariances.check_commutes_with_rotations, swapped_product),
    (invariances.check_commutes_with_rotations, towards_the_first_axis),
    (invariances.check_commutes_with_rotations, world_axes),
    (invariances.check_joints_do_not_mix, joint_mixer),
    (invariances.check_time_reversal, one_sided),
    (invariances.check_missing_frame_stays_alone, nan_spreader),
    (invariances.check_missing_frame_stays_alone, softmax_spreader),
    (invariances.check_missing_frame_stays_alone, gap_keeper),
    (invariances.check_missing_frame_has_no_gradient, nan_spreader),
    (invariances.check_scale_and_input_untouched, writer),
    (invariances.check_output, unnormalised),
    (invariances.check_output, dice),
    (invariances.check_does_not_look_ahead, good),
]


def arguments(check, q, rng):
    takes_rng = "rng" in check.__annotations__
    return (q, rng) if takes_rng else (q,)


@pytest.mark.parametrize(("check", "fault"), FAULTS)
def test_sees_the_fault(check, fault, q, rng):
    with pytest.raises(AssertionError):
        check(fault, *arguments(check, q, rng))


@pytest.mark.parametrize("check", dict.fromkeys(check for check, _ in FAULTS[:-1]))
def test_passes_a_good_filter(check, q, rng):
    check(good, *arguments(check, q, rng))


@pytest.mark.parametrize("fault", [DropsTheLastFrame, HalvesDetails])
def test_B4_sees_what_does_not_come_back(fault, q):
    invariances.check_comes_back(LiftingTransform("linear"), q)
    with pytest.raises(AssertionError):
        invariances.check_comes_back(fault("linear"), q)


def test_B19_sees_a_batch_mixer(rng):
    with pytest.raises(AssertionError, match="batch items mix"):
        invariances.check_batch_does_not_mix(batch_mixer, smooth_motion(3, rng=rng))


def test_A4_sees_components_averaged(rng):
    with pytest.raises(AssertionError):
        invariances.check_alternating_signs(component_mean, rng)


def test_A20_sees_a_drift(rng):
    with pytest.raises(AssertionError):
        invariances.check_constant_motion(drifter, rng, torch.float64)


@pytest.mark.parametrize("fault", [swapped_product, half_angle, plus_sign_of_b_r, world_axes])
def test_the_oracle_sees_the_fault(fault, q):
    expected = reference.every_joint(
        reference.bilateral_filter,
        numpy_of(q),
        np.ones(q.shape[:-1]),
        sigma_t=1.0,
        sigma_g=0.5,
        radius=3,
    )
    assert_same_rotation(good(q), torch.from_numpy(expected), 1e-10)
    with pytest.raises(AssertionError, match="largest angle"):
        assert_same_rotation(fault(q), torch.from_numpy(expected), 1e-10)


def test_comparison_by_angle_forgives_neither_half_a_degree_nor_nan(rng):
    q = random_rotations(5, rng=rng)
    near = so3.compose(q, so3.exp(torch.tensor([0.0087, 0.0, 0.0], dtype=q.dtype)))
    assert (1 - (q * near).sum(-1).abs() < 1e-5).all(), "what a bound on the dot product forgives"
    with pytest.raises(AssertionError, match="largest angle"):
        assert_same_rotation(near, q, 1e-3)
    with pytest.raises(AssertionError, match="NaN"):
        assert_same_rotation(torch.full_like(q, torch.nan), q, 1.0)
    assert_same_rotation(-q, q)
