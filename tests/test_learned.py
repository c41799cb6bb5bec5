"""Learned blocks: they start at what they extend, keep its symmetries, and learn."""

import pytest
import torch
from filters_under_test import shaken
from motions import BOUND, IDENTITY, assert_same_rotation, random_rotations, smooth_motion
from torch.autograd import gradcheck

from torchquat import (
    LearnedPredict,
    LearnedUpdate,
    LiftingDenoiser,
    LiftingStep,
    LiftingTransform,
    NonLocalPoseMeans,
    PatchEmbedding,
    SquadPredict,
    noise,
    so3,
)

WIDTHS = [(1, 0), (8, 2), (3, 4)]
"""Channels and radius."""


def learned_step(channels=8, radius=2, *, trained=True):
    torch.manual_seed(0)
    step = LiftingStep(LearnedPredict(channels, radius), LearnedUpdate(channels, radius))
    return shaken(step).requires_grad_() if trained else step


@pytest.mark.parametrize("width", WIDTHS)
def test_new_blocks_are_the_linear_wavelet_bitwise(width, rng, dtype):
    for frames in (0, 1, 2, 3, 21):
        q = smooth_motion(2, frames=frames, rng=rng, dtype=dtype)
        learned = LiftingTransform(learned_step(*width, trained=False), levels=3)
        linear = LiftingTransform("linear", levels=3)
        pyramid, expected = learned(q), linear(q)
        assert torch.equal(pyramid.approx, expected.approx)
        for one, other in zip(pyramid.details, expected.details, strict=True):
            assert torch.equal(one, other)
        assert torch.equal(learned.inverse(pyramid), linear.inverse(expected))


@pytest.mark.parametrize("width", WIDTHS[1:])
def test_B4_every_length_comes_back(width, rng, dtype):
    long = smooth_motion(frames=20, step=0.5, rng=rng, dtype=dtype)
    transform = LiftingTransform(learned_step(*width), levels=3)
    for frames in range(1, 21):
        back = transform.inverse(transform(long[:frames]))
        assert_same_rotation(back, long[:frames], BOUND[dtype])


def test_it_can_hold_squad(rng):
    """About one axis, with lengths that do not saturate."""
    block = LearnedPredict(channels=1, radius=1).double()
    with torch.no_grad():
        block.network.kernel.copy_(torch.tensor([[1.0], [0.0], [-1.0]]))
        block.network.mix.fill_(1 / 16)
        block.network.log_large.fill_(20.0)
    angles = torch.randn(20, 1, 1, generator=rng, dtype=torch.float64).cumsum(0)
    even = so3.exp(0.1 * angles * torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64))
    assert_same_rotation(block(even)[2:-2], SquadPredict()(even)[2:-2])


def test_steps_go_with_world_and_body_frame(rng, dtype):
    q = smooth_motion(frames=21, rng=rng, dtype=dtype)
    left, right = random_rotations(2, 1, 1, rng=rng, dtype=dtype)
    transform = LiftingTransform(learned_step(), levels=2)
    plain = LiftingTransform("linear", levels=2)
    approx, details = transform(q)
    assert (details[-1] - plain(q).details[-1]).abs().max() > 1e-3, "nothing learned, nothing shown"
    turned = transform(so3.compose(so3.compose(left, q), right))
    assert_same_rotation(turned.approx, so3.compose(so3.compose(left, approx), right))
    for one, other in zip(details, turned.details, strict=True):
        assert torch.allclose(so3.rotate(so3.inverse(right), one), other, atol=BOUND[dtype])


def test_steady_motion_goes_on_beyond_both_ends():
    """Every frame sees the same increments, at the ends too: so all steps are alike."""
    angle = 0.1 * torch.arange(9.0, dtype=torch.float64)
    even = so3.exp(torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64) * angle[:, None, None])
    step = so3.between(even, learned_step().predict(even))
    torch.testing.assert_close(step, step[4:5].expand_as(step), rtol=0, atol=1e-12)
    assert (step[4].norm() - 0.05).abs() > 1e-3  # what it has learned shows


def test_every_parameter_takes_part(rng):
    q = smooth_motion(frames=21, rng=rng)
    step = learned_step()
    pyramid = LiftingTransform(step, levels=2)(q)
    squares = [so3.log(pyramid.approx).square().sum(), *(d.square().sum() for d in pyramid.details)]
    torch.stack(squares).sum().backward()
    for name, parameter in step.named_parameters():
        assert parameter.grad is not None and (parameter.grad != 0).all(), name


def test_signs_make_no_difference(rng):
    q = smooth_motion(frames=21, rng=rng)
    block = learned_step().predict
    assert_same_rotation(block(noise.flip_signs(q, generator=rng)), block(q))


def test_only_frames_within_the_radius_count(rng):
    """A convolution over time: its reach is its radius, and all places are alike."""
    v = torch.randn(30, 1, 3, generator=rng, dtype=torch.float64)
    update = learned_step(radius=2).update
    other = v.clone()
    other[15] += 0.1
    moved = (update(other) - update(v)).abs().amax((1, 2)) > 0
    assert moved.nonzero()[:, 0].tolist() == [13, 14, 15, 16, 17, 18]
    assert torch.allclose(update(v)[10:20], update(v[5:])[5:15], atol=1e-15)
    q = smooth_motion(frames=30, rng=rng)
    predict = learned_step(radius=2).predict
    turned = torch.cat([q[:15], so3.turn(q[15:], 0.1 * torch.ones(15, 3, 3).double())])
    moved = so3.distance(predict(turned), predict(q))[:, 0]
    stiff = so3.distance(turned, q)[:, 0]  # increments before and after stay the same
    assert (moved[:12] == 0).all() and (moved[12:17] > 0).all()
    assert torch.allclose(moved[17:], stiff[17:])


def test_joints_and_batch_do_not_mix(rng):
    q = smooth_motion(2, 3, frames=9, rng=rng)
    transform = LiftingTransform(learned_step(), levels=2)
    approx, details = transform(q)
    alone = transform(q[1, 2, :, 1:2])
    assert_same_rotation(alone.approx, approx[1, 2, :, 1:2])
    assert torch.allclose(alone.details[0], details[0][1, 2, :, 1:2], atol=1e-14)


def test_derivatives(rng):
    q = smooth_motion(frames=7, joints=1, step=0.5, rng=rng).requires_grad_()
    step = learned_step(2, 1).double()
    names, values = zip(*step.named_parameters(), strict=True)

    def both(q, *parameters):
        given = dict(zip(names, parameters, strict=True))
        coarse, detail = torch.func.functional_call(step, given, (q,))
        return coarse, detail

    assert gradcheck(both, (q, *values), fast_mode=True)


@pytest.mark.parametrize("scale", [1.0, -1.0])
@pytest.mark.parametrize("trained", [True, False])
def test_A1_A2_gradients_are_finite_where_nothing_moves(scale, trained, dtype):
    q = (scale * IDENTITY.to(dtype)).expand(2, 9, 1, 4).clone().requires_grad_()
    run = LiftingDenoiser(learned_step(trained=trained), rule=0.1, learnable=True)
    run(q).sum().backward()
    for x in (q, *run.parameters()):
        assert x.grad is not None and x.grad.isfinite().all()


def test_training_lowers_the_loss_on_motion_it_has_not_seen(rng):
    torch.manual_seed(0)
    run = LiftingDenoiser(learned_step(trained=False), levels=2, learnable=True)
    optimizer = torch.optim.Adam(run.parameters(), lr=0.02)
    clean = smooth_motion(8, frames=40, step=0.05, rng=rng, dtype=torch.float32)
    unseen = smooth_motion(8, frames=40, step=0.05, rng=rng, dtype=torch.float32)
    noisy = noise.gaussian(unseen, 0.1, generator=rng)
    with torch.no_grad():
        before = so3.squared_distance(run(noisy), unseen).mean()
    losses = []
    for _ in range(15):
        made = run(noise.gaussian(clean, 0.1, generator=rng))
        losses.append(so3.squared_distance(made, clean).mean())
        optimizer.zero_grad()
        losses[-1].backward()
        optimizer.step()
    with torch.no_grad():
        after = so3.squared_distance(run(noisy), unseen).mean()
    assert after < 0.95 * before, f"{before:.2e} -> {after:.2e}"
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in run.parameters())


def test_one_step_lowers_the_loss(rng):
    run = LiftingDenoiser(learned_step(trained=False), levels=2, rule=0.1)
    clean = smooth_motion(4, frames=30, step=0.05, rng=rng, dtype=torch.float32)
    noisy = noise.gaussian(clean, 0.1, generator=rng)
    optimizer, losses = torch.optim.SGD(run.parameters(), lr=0.1), []
    for _ in range(2):
        losses.append(so3.squared_distance(run(noisy), clean).mean())
        optimizer.zero_grad()
        losses[-1].backward()
        optimizer.step()
    assert losses[1] < losses[0]


@pytest.mark.parametrize("causal", [False, True])
def test_a_new_embedding_starts_at_the_plain_distance_and_learns(causal, rng):
    torch.manual_seed(0)
    q = smooth_motion(frames=30, rng=rng, dtype=torch.float32)
    options = {"patch_radius": 3, "search_radius": 5, "causal": causal}
    learned = NonLocalPoseMeans(
        0.2, embedding=PatchEmbedding(3, joints=3, causal=causal), learnable=True, **options
    )
    plain = NonLocalPoseMeans(0.2, **options)
    assert_same_rotation(learned(q), plain(q), 1e-5)
    so3.squared_distance(learned(q), q).mean().backward()
    assert all(p.grad.isfinite().all() and p.grad.abs().sum() > 0 for p in learned.parameters())


def test_an_embedding_fits_every_skeleton_and_follows_a_common_turn(rng):
    embedding = shaken(PatchEmbedding(2, features=3))
    patch = torch.randn(2, 9, 5, 4, 3, generator=rng, dtype=torch.float64)
    assert embedding(patch).shape == (2, 9, 4 * 3 * 3)
    assert embedding(patch[..., :1, :]).shape == (2, 9, 3 * 3)
    assert embedding(patch[:, :, :, :0]).shape == (2, 9, 0)
    turned = so3.rotate(random_rotations(1, rng=rng), patch)
    for one, other in ((patch, turned), (patch[:1], turned[:1])):
        lengths = [torch.cdist(embedding(x), embedding(x)) for x in (one, other)]
        assert torch.allclose(*lengths, atol=1e-12)


def test_joints_of_an_embedding_count_by_their_gain(rng):
    embedding = shaken(PatchEmbedding(2, joints=2))
    embedding.gain[1] = 0.0
    patch = torch.randn(9, 5, 2, 3, generator=rng, dtype=torch.float64)
    other = torch.cat([patch[:, :, :1], 2.0 * patch[:, :, 1:]], -2)
    assert torch.equal(embedding(patch), embedding(other))
    assert not torch.equal(embedding(patch), embedding(other.flip(-2)))
    before, once = float(embedding.gain[0]), embedding(patch)
    embedding.gain[0] = 3.0 * before
    assert torch.allclose(embedding(patch), 3.0 * once)


def test_new_blocks_have_the_size_that_checkpoints_expect_and_keep_that_of_what_they_see():
    torch.manual_seed(0)
    for block, shape in (
        (LearnedPredict(), (5, 8, 1)),
        (LearnedUpdate(), (4, 8, 1)),
        (PatchEmbedding(), (11, 8, 4)),
    ):
        kernel, mix = block.network.kernel, block.network.mix
        assert (*kernel.shape, mix.shape[1]) == shape and len(mix) == 8
        # white noise comes out as large as it goes in
        assert 0.5 < kernel.detach().square().sum(0).mean().item() < 2.0


def test_bad_options_are_named():
    for block in (LearnedPredict, LearnedUpdate):
        with pytest.raises(ValueError, match="channels must be >= 1, got 0"):
            block(0)
        with pytest.raises(ValueError, match="radius must be >= 0, got -1"):
            block(8, -1)
    with pytest.raises(ValueError, match="patch_radius must be >= 0, got -1"):
        PatchEmbedding(-1)
    with pytest.raises(ValueError, match="features must be >= 1, got 0"):
        PatchEmbedding(features=0)
    with pytest.raises(ValueError, match=r"^channels must be >= 1, got 0"):
        PatchEmbedding(channels=0)
    with pytest.raises(ValueError, match="joints must be >= 1, got 0"):
        PatchEmbedding(joints=0)
    with pytest.raises(ValueError, match="patch must have 4 joints, got 1"):
        PatchEmbedding(2, joints=4)(torch.zeros(4, 9, 5, 1, 3))
    PatchEmbedding(2, joints=4)(torch.zeros(7, 9, 5, 4, 3))
    with pytest.raises(
        ValueError, match=r"patch must have 5 frames, as patch_radius and causal say, got 11\."
    ):
        PatchEmbedding(2)(torch.zeros(9, 11, 1, 3))
