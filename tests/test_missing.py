"""Which frames are missing, and what stands in their place."""

import pytest
import torch
from motions import IDENTITY, assert_same_rotation, random_rotations, smooth_motion

from torchquat import fill_missing, so3, validity
from torchquat.missing import confidence


@pytest.mark.parametrize("bad", [0.0, torch.nan, torch.inf, -torch.inf])
def test_A11_A14_A15_frames_without_a_direction_are_missing(bad, rng, dtype):
    q = random_rotations(4, 2, rng=rng, dtype=dtype)
    q[1, 0] = bad
    q[2, 1, 3] = bad if bad else q[2, 1, 3]
    wanted = torch.ones(4, 2, dtype=torch.bool)
    wanted[1, 0] = False
    wanted[2, 1] = bad == 0.0
    assert torch.equal(validity(q), wanted)


@pytest.mark.parametrize("weight", [0.0, -1.0, torch.nan, torch.inf])
def test_frames_without_weight_are_missing(weight, rng):
    weights = torch.ones(4, 1).double()
    weights[1] = weight
    assert validity(random_rotations(4, 1, rng=rng), weights)[:, 0].tolist() == [1, 0, 1, 1]


@pytest.mark.parametrize(
    ("dtype", "least", "most"), [(torch.float32, 1e-31, 3e15), (torch.float64, 1e-292, 2e123)]
)
def test_weights_that_cannot_be_computed_with(dtype, least, most, rng):
    """Too small a one is none; too large a one counts as the largest that can be multiplied."""
    q = random_rotations(4, 1, rng=rng, dtype=dtype)
    assert confidence(q).dtype == dtype and (confidence(q) == 1.0).all()
    given = torch.tensor([0.9 * least, 1.1 * least, 0.8 * most, 10.0 * most], dtype=dtype)
    small, kept, large, cut = confidence(q, given[:, None])[:, 0]
    assert small == 0.0 and kept == given[1] and large == given[2]
    assert cut == pytest.approx(most, rel=0.25)


def test_B15_masks_and_weights_broadcast(rng):
    q = random_rotations(2, 3, 4, rng=rng)
    mask = torch.tensor([True, False, True])
    assert torch.equal(validity(q, mask[:, None]), mask[:, None].expand(2, 3, 4))
    assert not validity(q, torch.zeros(3, 4, dtype=torch.bool)).any()


def test_gaps_are_crossed_at_constant_angular_velocity(rng):
    q = smooth_motion(frames=9, rng=rng, step=0.4)
    spoiled = q.clone()
    spoiled[3:7, 1] = torch.nan
    filled = fill_missing(spoiled)
    turn = so3.log(so3.relative(filled[2:7, 1], filled[3:8, 1]))
    assert torch.allclose(turn, turn[:1].expand_as(turn), atol=1e-12)
    others = [0, 1, 2, 7, 8]
    assert_same_rotation(filled[others], q[others])
    assert_same_rotation(filled[:, [0, 2]], q[:, [0, 2]])


def test_A16_ends_hold_the_nearest_frame(rng, dtype):
    q = random_rotations(8, 1, rng=rng, dtype=dtype)
    weight = torch.zeros(8, 1, dtype=torch.bool)
    weight[3:5] = True
    filled = fill_missing(q, weight)
    assert_same_rotation(filled, q[[3, 3, 3, 3, 4, 4, 4, 4]])


def test_causal_holds_the_last_frame_and_the_start_holds_the_first(rng):
    q = random_rotations(6, 1, rng=rng)
    weight = torch.tensor([0, 1, 0, 0, 1, 0]).bool()[:, None]
    assert_same_rotation(fill_missing(q, weight, causal=True), q[[1, 1, 1, 1, 4, 4]])


def test_A17_a_joint_missing_throughout_keeps_what_has_a_direction(rng):
    q = random_rotations(3, 2, rng=rng)
    q[1, 0] = torch.nan
    weight = torch.tensor([0.0, 1.0]).double().expand(3, 2)
    filled = fill_missing(q, weight)
    assert_same_rotation(filled[[0, 2]], q[[0, 2]])
    assert torch.equal(filled[1, 0], IDENTITY)


def test_A14_no_gradient_reaches_a_missing_frame(rng):
    q = smooth_motion(frames=5, joints=1, rng=rng)
    q[2] = torch.inf
    q.requires_grad_()
    fill_missing(q).square().cumsum(-1).sum().backward()
    assert q.grad.isfinite().all() and not q.grad[2].any() and q.grad[1].any()


def test_A17_no_gradient_reaches_a_joint_missing_throughout(rng):
    """Its values are passed on, as nothing better is known; they are not to be trained on."""
    q = smooth_motion(frames=5, joints=2, rng=rng).requires_grad_()
    weight = torch.tensor([0.0, 1.0]).double().expand(5, 2)
    fill_missing(q, weight).square().cumsum(-1).sum().backward()
    assert not q.grad[:, 0].any() and q.grad[:, 1].any()


def test_values_under_weight_0_do_not_matter(rng):
    q = random_rotations(5, 1, rng=rng)
    weight = torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0]).double()[:, None]
    other = q.clone()
    other[2] = torch.nan
    assert torch.equal(fill_missing(q, weight), fill_missing(other, weight))


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_B9_half_precision(half, rng):
    """Rounded once, at the end."""
    q = random_rotations(9, 1, rng=rng).to(half)
    there = torch.tensor([1, 1, 0, 0, 0, 0, 0, 1, 1], dtype=torch.bool)[:, None]
    assert torch.equal(fill_missing(q, there), fill_missing(q.float(), there).to(half))


def test_the_input_is_not_written_to(rng):
    q = random_rotations(5, 1, rng=rng)
    q[2] = torch.nan
    version = q._version
    fill_missing(q)
    assert q._version == version and q[2].isnan().all()


@pytest.mark.parametrize("ask", [validity, fill_missing])
def test_B15_weights_of_another_shape_are_refused(ask, rng):
    with pytest.raises(ValueError, match="weight must"):
        ask(random_rotations(5, 2, rng=rng), torch.ones(4, 2, dtype=torch.float64))
