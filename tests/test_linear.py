"""Lee and Shin's construction for any mask, against loops that share no code with it."""

import copy

import numpy as np
import pytest
import reference
import torch
from motions import angle_between, assert_same_rotation, numpy_of, smooth_motion
from patterns import PATTERNS, with_pattern
from torch.autograd import gradcheck, gradgradcheck

from torchquat import (
    GaussianFilter,
    LinearFilter,
    gaussian_filter,
    linear_filter,
    metrics,
    noise,
    so3,
)
from torchquat.timeline import BOUNDARIES

MASKS = {
    "binomial": [1.0, 4.0, 6.0, 4.0, 1.0],
    "asymmetric": [0.1, 0.5, 0.2, 0.7, 0.3],
    "sharpening": [-0.2, 0.3, 0.8, 0.3, -0.2],
    "savitzky-golay": [-2.0, 3.0, 6.0, 7.0, 6.0, 3.0, -2.0],
    "one": [3.0],
}


def weights_of(q, weight):
    return np.ones(q.shape[:-1]) if weight is None else numpy_of(weight)


@pytest.mark.parametrize("causal", [False, True], ids=["centred", "causal"])
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("mask", MASKS)
def test_agrees_with_the_loop(mask, boundary, pattern, causal, rng):
    if causal and mask == "savitzky-golay":
        mask = "sharpening"  # its earlier half sums to more than 0 as well
    for frames in (1, 2, 3, 12):
        q, weight = with_pattern(smooth_motion(frames=frames, rng=rng, step=0.4), pattern, rng)
        actual = linear_filter(q, weight, mask=MASKS[mask], boundary=boundary, causal=causal)
        expected = reference.every_joint(
            reference.linear_filter,
            numpy_of(q),
            weights_of(q, weight),
            mask=MASKS[mask],
            boundary=boundary,
            causal=causal,
        )
        assert_same_rotation(actual, torch.from_numpy(expected), 1e-10)


@pytest.mark.parametrize("causal", [False, True], ids=["centred", "causal"])
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_gaussian_agrees_with_the_loop(boundary, causal, rng):
    for frames, pattern in ((1, "none"), (3, "gaps"), (12, "nan"), (12, "confidence")):
        q, weight = with_pattern(smooth_motion(frames=frames, rng=rng, step=0.4), pattern, rng)
        sigma_t = [0.7, 1.3, 2.0]
        actual = gaussian_filter(
            q, weight, sigma_t=sigma_t, radius=4, boundary=boundary, causal=causal
        )
        expected = reference.every_joint(
            reference.gaussian_filter,
            numpy_of(q),
            weights_of(q, weight),
            radius=4,
            boundary=boundary,
            causal=causal,
            per_joint={"sigma_t": sigma_t},
        )
        assert_same_rotation(actual, torch.from_numpy(expected), 1e-10)


@pytest.mark.parametrize("other", ["binomial", "sharpening"])
def test_a_mask_per_joint_is_each_joint_with_its_mask(other, rng):
    q = smooth_motion(frames=9, joints=2, rng=rng)
    masks = torch.tensor([MASKS[other], MASKS["asymmetric"]], dtype=q.dtype)
    together = linear_filter(q, mask=masks.T)
    for joint in range(2):
        alone = linear_filter(q[:, [joint]], mask=masks[joint])
        assert_same_rotation(together[:, [joint]], alone)


@pytest.mark.parametrize("mask", [[1.0, 1.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.5, 1.0, 0.5, 1.0]])
def test_a_signal_that_wants_a_gradient_is_filtered_the_same(mask, rng):
    q = smooth_motion(frames=6, joints=1, rng=rng)
    expected = linear_filter(q, mask=mask)
    q.requires_grad_()
    assert_same_rotation(linear_filter(q, mask=mask).detach(), expected)
    assert gradcheck(lambda q: linear_filter(q, mask=mask), q)


def test_kept_masks_of_later_frames_shift_the_sequence(rng):
    """``m_1 = 1`` takes every frame to the one after it: the mask is not mirrored."""
    q = smooth_motion(frames=8, rng=rng)
    assert_same_rotation(linear_filter(q, mask=[0.0, 0.0, 1.0])[:-1], q[1:])


@pytest.mark.parametrize("mask", ["binomial", "sharpening", "savitzky-golay", "one"])
def test_constant_angular_velocity_is_kept_by_symmetric_masks(mask, rng, dtype):
    turn = so3.exp(torch.tensor([0.1, -0.2, 0.15], dtype=torch.float64))
    q = [smooth_motion(frames=1, joints=2, rng=rng)[0]]
    for _ in range(11):
        q.append(so3.compose(q[-1], turn))
    q = torch.stack(q).to(dtype)
    assert_same_rotation(linear_filter(q, mask=MASKS[mask], boundary="extrapolate"), q)
    assert_same_rotation(gaussian_filter(q, sigma_t=1.5, boundary="extrapolate"), q)


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_radius_0_changes_nothing(boundary, rng, dtype):
    q = smooth_motion(rng=rng, dtype=dtype)
    assert_same_rotation(gaussian_filter(q, sigma_t=1.0, radius=0, boundary=boundary), q)
    assert_same_rotation(linear_filter(q, mask=[2.0], boundary=boundary), q)


def test_causal_filters_do_not_look_ahead(rng):
    q = smooth_motion(frames=12, rng=rng)
    later = q.clone()
    later[7:] = smooth_motion(frames=5, rng=rng)
    later[9, 1] = torch.nan
    for run in (
        lambda q: gaussian_filter(q, sigma_t=1.0, causal=True),
        lambda q: gaussian_filter(q, sigma_t=1.0, causal=True, boundary="replicate"),
        LinearFilter([1.0, 2.0, 3.0, 0.0, 0.0]),
    ):
        assert torch.equal(run(q)[:7], run(later)[:7])


def test_a_mask_without_a_later_half_is_causal(rng):
    q = smooth_motion(frames=12, rng=rng)
    weight = torch.ones(12, 3, dtype=torch.bool)
    weight[6:8] = False
    for mask, causal in (
        ([0.25, 0.25, 0.5, 0.0, 0.0], True),
        ([0.0, 1.0, 0.0], True),
        ([0.25, 0.25, 0.3, 0.2, 0.0], False),
        ([0.25, 0.25, 0.3, 0.0, 0.2], False),
        ([1.0], False),  # what stands in a gap may come from both of its ends
    ):
        module = LinearFilter(mask)
        assert module.causal == causal
        assert_same_rotation(
            module(q, weight), linear_filter(q, weight, mask=mask, causal=causal), 1e-7
        )


def test_modules_are_their_functions(rng):
    q = smooth_motion(2, rng=rng, dtype=torch.float32)
    weight = torch.rand(q.shape[:-1], generator=rng)
    module = GaussianFilter(1.5, radius=3, boundary="circular", causal=True)
    assert_same_rotation(
        module(q, weight),
        gaussian_filter(q, weight, sigma_t=1.5, radius=3, boundary="circular", causal=True),
    )
    module = LinearFilter(MASKS["asymmetric"], boundary="truncate")
    assert torch.equal(
        module(q, weight), linear_filter(q, weight, mask=MASKS["asymmetric"], boundary="truncate")
    )
    assert "1.5" in repr(GaussianFilter(1.5)) and "reflect" in repr(LinearFilter([1.0]))


def test_a_mask_that_is_loaded_may_look_ahead_where_the_first_did_not(rng):
    q = smooth_motion(frames=12, rng=rng)
    run, other = LinearFilter([1.0, 2.0, 0.0]), LinearFilter([1.0, 2.0, 3.0])
    for module in (run, copy.deepcopy(run)):
        module.load_state_dict(other.state_dict())
        assert not module.causal and torch.equal(module(q), other(q))


@pytest.mark.parametrize("mask", [[1e39, 1.0, 1.0], [1e-50, 1e-50, 1e-50]])
def test_A23_masks_that_single_precision_does_not_hold(mask):
    with pytest.raises(ValueError, match="mask must be finite with a sum > 0, got"):
        LinearFilter(mask)


def test_entries_too_small_to_divide_by_count_for_nothing(rng):
    q = smooth_motion(frames=8, rng=rng)
    assert_same_rotation(linear_filter(q, mask=[1e-310, 1.0, 1e-310]), q)


def test_gradients_of_signal_weights_mask_and_bandwidth(rng):
    q = smooth_motion(frames=4, joints=1, rng=rng).requires_grad_()
    weight = (0.2 + torch.rand(4, 1, generator=rng, dtype=torch.float64)).requires_grad_()
    sigma_t = torch.tensor(0.8, dtype=torch.float64, requires_grad=True)
    mask = torch.tensor([0.2, 0.5, 0.3], dtype=torch.float64, requires_grad=True)

    def gaussian(q, weight, sigma_t):
        return gaussian_filter(q, weight, sigma_t=sigma_t, radius=2)

    def linear(q, weight, mask):
        return linear_filter(q, weight, mask=mask, boundary="extrapolate")

    for run, parameter in ((gaussian, sigma_t), (linear, mask)):
        assert gradcheck(run, (q, weight, parameter))
        assert gradgradcheck(run, (q, weight, parameter), fast_mode=True)


@pytest.mark.parametrize("mask", [[0.0, 1.0, 0.0], [-0.1, 0.0, 1.2, 0.0, -0.1]])
def test_entries_that_are_0_can_be_learned(mask, rng):
    """A mask that is the identity is where learning one begins."""
    q = smooth_motion(frames=5, joints=2, rng=rng)
    mask = torch.tensor(mask, dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda mask: linear_filter(q, mask=mask), mask)


@pytest.mark.parametrize("sigma_t", [1.0, [0.5, 1.0, 1.5]], ids=["one", "per-joint"])
def test_learnable_bandwidth_stays_positive(sigma_t, rng):
    module = GaussianFilter(sigma_t, learnable=True)
    optimiser = torch.optim.SGD(module.parameters(), lr=1e6)
    q = smooth_motion(rng=rng, dtype=torch.float32)
    (1.0 - (module(q) * q).sum(-1)).sum().backward()
    assert module.log_sigma_t.grad.isfinite().all() and (module.log_sigma_t.grad != 0).all()
    optimiser.step()
    assert (module.sigma_t >= 0).all()
    assert not list(GaussianFilter(1.0).parameters()) and "log_sigma_t" in module.state_dict()


def test_denoises(rng):
    gains = []
    for _ in range(5):
        clean = smooth_motion(frames=100, step=0.02, rng=rng)
        noisy = noise.gaussian(clean, 0.1, generator=rng)
        filtered = gaussian_filter(noisy, sigma_t=2.0)
        gains.append(float(metrics.psnr(filtered, clean) - metrics.psnr(noisy, clean)))
    gain = sum(gains) / len(gains)
    # a Gaussian of sigma 2 leaves 1 / (2 sqrt(pi) sigma) of white noise: 8.5 dB
    assert 7.0 < gain < 9.0, f"gain {gain:.2f} dB"


def test_no_pattern_of_gaps_raises_the_gain_of_a_mask_with_negative_entries(rng):
    """Normalised in one sum, the lobes of a Savitzky-Golay mask would nearly cancel."""
    q = smooth_motion(frames=40, step=0.02, rng=rng)
    weight = torch.zeros(40, 3, dtype=torch.bool)
    weight[::3] = True
    filtered = linear_filter(q, weight, mask=MASKS["savitzky-golay"])
    assert angle_between(filtered, q).max() < 0.5


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda q: linear_filter(q, mask=[1.0, 1.0]), r"mask must have shape \(2k \+ 1,\)"),
        (lambda q: LinearFilter([1.0, 1.0]), r"mask must have shape \(2k \+ 1,\)"),
        (
            lambda q: linear_filter(q, mask=torch.ones(3, 2).double()),
            "mask must have one column or 3, got 2",
        ),
        (lambda q: LinearFilter([1.0], boundary="zero"), "^boundary must be one of"),
        (
            lambda q: LinearFilter(torch.tensor([[1.0, -1.0], [1.0, 0.5], [1.0, 0.2]])),
            "^mask must be finite with a sum > 0",
        ),
        (lambda q: LinearFilter([1.0, torch.nan, 1.0]), "mask must be finite with a sum > 0"),
        (
            lambda q: LinearFilter([-1.0, 1.0, 0.0]),
            r"mask must be finite with a sum > 0, got \[-1\.0, 1\.0, 0\.0\]",
        ),
        (lambda q: gaussian_filter(q, sigma_t=0.0), "sigma_t must be finite and > 0, got 0.0"),
        (lambda q: GaussianFilter(-1.0), "sigma_t must be finite and > 0, got -1.0"),
        (lambda q: GaussianFilter([1.0, float("inf")]), "sigma_t must be finite and > 0"),
        (lambda q: gaussian_filter(q, sigma_t=1.0, radius=-1), "radius must be >= 0, got -1"),
        (lambda q: GaussianFilter(boundary="mirror"), "boundary must be one of truncate, .*mirror"),
        (lambda q: gaussian_filter(q, sigma_t=1.0, boundary="zero"), "boundary must be one of"),
    ],
)
def test_says_what_is_wrong(call, message, rng):
    with pytest.raises(ValueError, match=message):
        call(smooth_motion(rng=rng))
