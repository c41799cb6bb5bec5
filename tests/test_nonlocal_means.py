"""Non-local pose means, against loops that share no code with them."""

import math

import numpy as np
import pytest
import reference_nonlocal
import torch
from motions import angle_between, assert_same_rotation, numpy_of, smooth_motion
from patterns import PATTERNS, with_pattern
from torch import nn
from torch.autograd import gradcheck, gradgradcheck

from torchquat import NonLocalPoseMeans, _blocks, metrics, noise, nonlocal_pose_means, so3
from torchquat.filters._patches import box_sum
from torchquat.timeline import BOUNDARIES

GROUPS = {"pose": [0, 0, 0], "joint": [0, 1, 2], (7, 2, 7): [7, 2, 7]}


def assert_agrees(q, weight, *, groups, **options):
    weights = np.ones(q.shape[:-1]) if weight is None else numpy_of(weight)
    expected = reference_nonlocal.nonlocal_pose_means(
        numpy_of(q), weights, groups=GROUPS[groups], **options
    )
    actual = nonlocal_pose_means(q, weight, groups=groups, **options)
    assert_same_rotation(actual, torch.from_numpy(expected), 1e-10)


@pytest.mark.parametrize("causal", [False, True], ids=["centred", "causal"])
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("chart", ["local", "global"])
def test_agrees_with_the_loop(chart, boundary, pattern, causal, rng):
    groups = list(GROUPS)
    for n, (frames, patch, search) in enumerate(((1, 1, 2), (2, 2, 1), (5, 2, 4), (9, 1, 3))):
        q = smooth_motion(frames=frames, rng=rng, step=0.3)
        q, weight = with_pattern(q, pattern, rng)
        options = {"patch_radius": patch, "search_radius": search, "causal": causal}
        assert_agrees(
            q, weight, sigma=0.2, chart=chart, boundary=boundary, groups=groups[n % 3], **options
        )


@pytest.mark.parametrize("groups", GROUPS, ids=str)
@pytest.mark.parametrize("sigma", [0.008, 0.1, 10.0])
def test_every_group_and_bandwidth_agrees_with_the_loop(groups, sigma, rng):
    """At 0.008 rad all weights underflow; relative to the largest they still make a mean."""
    q, weight = with_pattern(smooth_motion(frames=8, rng=rng), "confidence", rng)
    assert_agrees(q, weight, groups=groups, sigma=sigma, patch_radius=1, search_radius=3)


@pytest.mark.parametrize("width", [*range(1, 12), 16, 21])
def test_box_sum_is_the_sum_of_the_box(width):
    x = torch.arange(90.0, dtype=torch.float64).square().reshape(30, 3)
    assert torch.equal(box_sum(x, width), x.unfold(0, width, 1).sum(-1))


def test_the_running_mean_does_not_forget_what_is_small_beside_what_was_large(rng):
    """Cumulative sums would: 1e-4 rad after half turns is below their rounding in float32."""
    q = smooth_motion(frames=40, step=2.0, rng=rng)
    calm = smooth_motion(frames=40, step=1e-4, rng=rng)
    options = {"sigma": 1e-4, "patch_radius": 2, "search_radius": 4}
    together = nonlocal_pose_means(torch.cat([q, calm]).float(), **options)[50:]
    assert_same_rotation(together, nonlocal_pose_means(calm, **options)[10:].float(), 2e-6)


def test_no_search_changes_nothing(rng, dtype):
    q = smooth_motion(rng=rng, dtype=dtype)
    assert_same_rotation(nonlocal_pose_means(q, search_radius=0), q)


def test_the_local_chart_follows_the_coordinate_frame_and_the_global_one_does_not(rng):
    q, turn = smooth_motion(rng=rng), smooth_motion(frames=1, joints=1, rng=rng)

    def deviation(chart):
        def run(q):
            return nonlocal_pose_means(q, sigma=0.3, chart=chart)

        return angle_between(run(so3.compose(turn, q)), so3.compose(turn, run(q))).max()

    assert deviation("local") < 1e-12
    assert deviation("global") > 1e-3


def test_a_repeated_gesture_is_averaged_with_its_repetition(rng):
    """What non-local means are for: the same gesture 12 frames on halves the noise and no more."""
    gesture = smooth_motion(frames=12, step=0.5, rng=rng)
    turn_back = gesture.flip(0)
    clean = torch.cat([gesture, turn_back, gesture, turn_back, gesture])
    noisy = noise.gaussian(clean, 0.02, generator=rng)
    options = {"sigma": 0.04, "patch_radius": 3}
    far = nonlocal_pose_means(noisy, search_radius=26, **options)
    near = nonlocal_pose_means(noisy, search_radius=4, **options)
    gains = [float(metrics.psnr(q, clean) - metrics.psnr(noisy, clean)) for q in (far, near)]
    assert gains[0] > gains[1] + 1.5 and gains[0] > 2.0, f"gains {gains} dB"


def test_limbs_that_share_a_group_share_weights(rng):
    """A joint in noise goes by the patches of its clean partner, not by its own."""
    q = smooth_motion(frames=30, joints=2, rng=rng)
    spoiled = q.clone()
    spoiled[:, 1] = noise.gaussian(q[:, 1:], 0.3, generator=rng)[:, 0]
    options = {"sigma": 0.1, "patch_radius": 2, "search_radius": 5}
    apart = nonlocal_pose_means(spoiled, groups=[3, 5], **options)
    alone = nonlocal_pose_means(spoiled[:, :1], **options)
    together = nonlocal_pose_means(spoiled, groups=[3, 3], **options)
    assert_same_rotation(apart[:, :1], alone)
    assert angle_between(together[:, :1], alone).max() > 1e-3


def test_a_frame_of_a_tenth_of_the_weight_pulls_a_tenth_as_hard(rng):
    """Three equal frames and one that is turned: the pull grows with its weight."""
    q = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64).expand(5, 1, 4).clone()
    angle = 0.02
    q[3, 0, 0], q[3, 0, 3] = math.sin(angle / 2), math.cos(angle / 2)
    weight = torch.ones(5, 1, dtype=torch.float64)
    pulls = []
    for trust in (1.0, 0.1):
        weight[3] = trust
        moved = nonlocal_pose_means(
            q, weight, sigma=10.0, patch_radius=0, search_radius=2, boundary="truncate"
        )
        pulls.append(float(angle_between(moved[2], q[2])))
    # a share of 1 / 5 against one of 0.1 / 4.1
    assert pulls[0] == pytest.approx(angle / 5, rel=1e-4)
    assert pulls[1] == pytest.approx(angle * 0.1 / 4.1, rel=1e-4)


@pytest.mark.parametrize("chart", ["local", "global"])
@pytest.mark.parametrize("groups", ["pose", "joint"])
def test_derivatives_for_signal_weight_and_bandwidth(chart, groups, rng):
    q = smooth_motion(frames=4, joints=2, step=0.5, rng=rng).requires_grad_()
    weight = (0.5 + torch.rand(4, 2, generator=rng, dtype=q.dtype)).requires_grad_()
    sigma = torch.tensor([0.3, 0.5], dtype=q.dtype, requires_grad=True)

    def run(q, weight, sigma):
        return nonlocal_pose_means(
            q, weight, sigma=sigma, patch_radius=1, search_radius=2, groups=groups, chart=chart
        )

    assert gradcheck(run, (q, weight, sigma))
    assert gradgradcheck(run, (q, weight, sigma), fast_mode=True)


@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_A1_A2_derivatives_at_the_identity_are_finite(scale):
    """All neighbours are equally good there, so only one-sided derivatives exist; finite ones."""
    q = torch.zeros(5, 2, 4, dtype=torch.float64)
    q[..., 3] = scale
    q.requires_grad_()
    result = nonlocal_pose_means(q, patch_radius=1, search_radius=2)
    (first,) = torch.autograd.grad(result.cumsum(-1).sum(), q, create_graph=True)
    (second,) = torch.autograd.grad(first.square().sum(), q)
    assert first.isfinite().all() and second.isfinite().all()


class Flat(nn.Module):
    """The patch as it is: adds to the distance what the distance is already."""

    def forward(self, patch):
        return patch.flatten(-3)


def test_an_embedding_of_nothing_changes_nothing_and_the_flat_patch_counts_twice(rng):
    q = smooth_motion(rng=rng)
    plain = {"patch_radius": 1, "search_radius": 3, "chart": "global"}
    twice = nonlocal_pose_means(q, sigma=0.2, embedding=Flat(), **plain)
    assert_same_rotation(twice, nonlocal_pose_means(q, sigma=0.2 / math.sqrt(2), **plain), 1e-10)

    for chart in ("local", "global"):
        options = plain | {"chart": chart, "sigma": 0.2}
        none = nonlocal_pose_means(
            q, embedding=lambda patch: torch.zeros(*patch.shape[:-3], 4).double(), **options
        )
        assert torch.equal(none, nonlocal_pose_means(q, **options))


@pytest.mark.parametrize("causal", [False, True])
def test_a_learned_embedding_keeps_the_contract_and_learns(causal, rng):
    torch.manual_seed(0)
    places, joints = (3 if causal else 5), 3
    embedding = nn.Sequential(nn.Flatten(-3), nn.Linear(places * joints * 3, 4)).double()
    module = NonLocalPoseMeans(
        0.1, patch_radius=2, search_radius=4, causal=causal, embedding=embedding, learnable=True
    )
    clean = smooth_motion(2, frames=30, step=0.05, rng=rng)
    noisy = noise.gaussian(clean, 0.05, generator=rng)
    noisy[0, 7, 1] = torch.nan
    optimiser = torch.optim.Adam(module.parameters(), lr=0.05)
    losses = []
    for _ in range(15):
        optimiser.zero_grad()
        loss = metrics.mean_squared_error(module(noisy), clean).mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert all(p.grad.isfinite().all() and p.grad.any() for p in module.parameters())
    assert losses[-1] < 0.9 * losses[0], f"{losses[0]:.5f} -> {losses[-1]:.5f}"


def test_bad_options_are_named():
    for options, message in (
        ({"groups": "limbs"}, "groups must be pose, joint, or a number for every joint, got 'lim"),
        ({"chart": "flat"}, "chart must be one of local, global, got 'flat'"),
        ({"boundary": "zeros"}, "boundary must be one of truncate, .* got 'zeros'"),
        ({"patch_radius": -1}, "patch_radius must be >= 0, got -1"),
        ({"search_radius": -1}, "search_radius must be >= 0, got -1"),
        ({"sigma": 0.0}, "sigma must be finite and > 0, got 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            NonLocalPoseMeans(**options)
    with pytest.raises(TypeError, match=r"groups must be pose, joint, .* got \[0\.5\]"):
        NonLocalPoseMeans(groups=[0.5])
    q = torch.ones(5, 3, 4)
    with pytest.raises(ValueError, match="groups must have a number for each of 3 joints, got 2"):
        nonlocal_pose_means(q, groups=[0, 1])
    with pytest.raises(ValueError, match=r"embedding must give features \(25, 'F'\), got \(2,"):
        nonlocal_pose_means(q, embedding=lambda patch: torch.zeros(2, 3))


def test_the_module_is_the_function(rng):
    q, weight = with_pattern(smooth_motion(rng=rng), "confidence", rng)
    module = NonLocalPoseMeans(0.1, patch_radius=2, search_radius=4, groups="joint", learnable=True)
    expected = nonlocal_pose_means(
        q, weight, sigma=module.sigma, patch_radius=2, search_radius=4, groups="joint"
    )
    assert torch.equal(module(q, weight), expected)
    assert [name for name, _ in module.named_parameters()] == ["log_sigma"]
    assert "sigma=0.1, patch_radius=2, search_radius=4, groups='joint'" in repr(module)


@pytest.mark.parametrize("groups", ["pose", "joint"])
@pytest.mark.parametrize("causal", [False, True])
@pytest.mark.parametrize("size", [1, 7, 60])
def test_blocks_of_time_make_no_difference(groups, causal, size, rng, monkeypatch):
    q, weight = with_pattern(smooth_motion(2, frames=31, rng=rng), "gaps", rng)
    options = {"sigma": 0.3, "patch_radius": 2, "search_radius": 4}
    whole = nonlocal_pose_means(q, weight, groups=groups, causal=causal, **options)
    monkeypatch.setattr(_blocks, "BLOCK", size)
    assert len(list(_blocks.blocks(q, 0))) > 1
    cut = nonlocal_pose_means(q, weight, groups=groups, causal=causal, **options)
    assert_same_rotation(cut, whole, 1e-14)


def test_B11_groups_are_counted_where_the_motion_is(rng):
    q, sizes = smooth_motion(rng=rng), {"sigma": 0.3, "patch_radius": 1, "search_radius": 3}
    expected = nonlocal_pose_means(q, groups=[0, 1, 0], **sizes)
    with torch.device("meta"):
        assert torch.equal(nonlocal_pose_means(q, groups=[0, 1, 0], **sizes), expected)
