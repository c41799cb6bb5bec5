"""Low-rank trajectories: agreement with plain loops, what stays as it is, what is gained."""

import math

import pytest
import reference_low_rank as reference
import torch
from motions import IDENTITY, angle_between, assert_same_rotation, numpy_of, smooth_motion
from test_spectral import swaying

from torchquat import LowRankFilter, low_rank_filter, noise, so3
from torchquat.filters import _hankel


@pytest.mark.parametrize(
    ("frames", "window"), [(1, 8), (2, 8), (5, 4), (13, 6), (25, 4), (40, 3), (60, 1), (7, 64)]
)
@pytest.mark.parametrize("span", [256, 16])
def test_agrees_with_plain_loops(frames, window, span, rng, monkeypatch):
    monkeypatch.setattr(_hankel, "SPAN", span)
    q = smooth_motion(frames=frames, joints=2, step=0.4, rng=rng)
    weight = 0.2 + torch.rand(frames, 2, generator=rng, dtype=torch.float64)
    found = low_rank_filter(q, weight, window=window, sigma=[0.2, 0.3])
    trust = numpy_of(weight / weight.amax(0))
    expected = reference.low_rank_motion(numpy_of(q), trust, (0.2, 0.3), window, span)
    assert_same_rotation(found, torch.from_numpy(expected), 1e-10)


@pytest.mark.parametrize(("sigma", "gain"), [(0.01, 6.0), (0.1, 10.0), (0.5, 9.0)])
def test_gains_on_noise_of_any_size(sigma, gain, rng):
    clean = swaying(joints=6)
    noisy = noise.gaussian(clean, sigma, generator=rng)
    for given in (None, sigma):
        after = angle_between(low_rank_filter(noisy, sigma=given), clean)
        ratio = angle_between(noisy, clean).square().mean() / after.square().mean()
        assert 10 * ratio.log10() > gain, f"{10 * ratio.log10():.1f} dB"


def test_turns_without_end_are_no_matter(rng):
    """Many turns about one axis, where no logarithm about one rotation is smooth."""
    angle = torch.linspace(0.0, 12.0 * math.pi, 300, dtype=torch.float64)[:, None, None]
    clean = so3.exp(angle * torch.tensor([0.0, 0.6, 0.8]).double()).expand(300, 4, 4)
    noisy = noise.gaussian(clean, 0.05, generator=rng)
    after = angle_between(low_rank_filter(noisy), clean)
    ratio = angle_between(noisy, clean).square().mean() / after.square().mean()
    assert 10 * ratio.log10() > 10.0, f"{10 * ratio.log10():.1f} dB"


def test_joint_without_noise_stays_and_takes_no_part(rng):
    clean = swaying(joints=3)
    noisy = torch.cat(
        [noise.gaussian(clean[:, :2], 0.05, generator=rng), clean[:1, 2:].expand(200, 1, 4)], 1
    )
    found = low_rank_filter(noisy)
    assert torch.equal(found[:, 2], noisy[:, 2])
    assert_same_rotation(found[:, :2], low_rank_filter(noisy[:, :2]), 1e-10)


def test_long_motion_is_seen_in_stretches(rng):
    """What happens far away does not matter."""
    q = smooth_motion(frames=1000, joints=1, rng=rng)
    other = torch.cat([q[:700], smooth_motion(frames=300, joints=1, rng=rng)])
    found, changed = (low_rank_filter(x, sigma=0.1) for x in (q, other))
    assert_same_rotation(found[:400], changed[:400], 1e-12)


def test_gradient_is_that_of_the_chosen_linear_filter(rng):
    """A turn of all frames turns the result, and what is all alike has finite derivatives."""
    q = so3.turn(IDENTITY, 0.01 * torch.randn(20, 2, 3, generator=rng, dtype=torch.float64))
    v = torch.zeros(20, 2, 3, dtype=torch.float64)

    def moved(v):
        return so3.between(q, low_rank_filter(so3.turn(q, v), sigma=0.01))

    slope = torch.autograd.functional.jacobian(moved, v)[:, 0, :, :, 0].sum(2)
    assert (slope - torch.eye(3)).abs().max() < 0.05
    still = IDENTITY.expand(20, 2, 4).clone().requires_grad_()
    low_rank_filter(still, sigma=0.01).cumsum(-1).sum().backward()
    assert still.grad.isfinite().all()


def test_module_and_arguments(rng):
    q = smooth_motion(rng=rng)
    run = LowRankFilter(4, sigma=[0.1, 0.2, 0.3])
    assert torch.equal(run(q), low_rank_filter(q, window=4, sigma=[0.1, 0.2, 0.3]))
    assert "window=4, sigma=[0.1, 0.2, 0.3]" in repr(run)
    for window, sigma, error, message in (
        (0, None, ValueError, r"window must be >= 1, got 0\."),
        (8.0, None, TypeError, r"window must be an integer, got 8\.0\."),
        (8, 0.0, ValueError, r"sigma must be finite and > 0, got 0\.0\."),
        (8, float("nan"), ValueError, r"sigma must be finite and > 0, got nan\."),
    ):
        with pytest.raises(error, match=message):
            LowRankFilter(window, sigma=sigma)
        with pytest.raises(error, match=message):
            low_rank_filter(q, window=window, sigma=sigma)
    with pytest.raises(ValueError, match=r"sigma must be one value or one per joint \(3\)"):
        low_rank_filter(q, sigma=[0.1, 0.2])
