"""Courty's bilateral filter, against loops that share no code with it."""

import numpy as np
import pytest
import reference
import torch
from motions import angle_between, assert_same_rotation, numpy_of, random_rotations, smooth_motion
from patterns import PATTERNS, with_pattern
from torch.autograd import gradcheck, gradgradcheck

from torchquat import BilateralFilter, bilateral_filter, gaussian_filter, metrics, noise, so3
from torchquat.timeline import BOUNDARIES

KERNELS = ("gaussian", "exponential")


def assert_agrees(q, weight, **options):
    ones = np.ones(q.shape[:-1])
    expected = reference.every_joint(
        reference.bilateral_filter,
        numpy_of(q),
        ones if weight is None else numpy_of(weight),
        **options,
    )
    assert_same_rotation(bilateral_filter(q, weight, **options), torch.from_numpy(expected), 1e-10)


@pytest.mark.parametrize("causal", [False, True], ids=["centred", "causal"])
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("kernel", KERNELS)
def test_agrees_with_the_loop(kernel, boundary, pattern, causal, rng):
    options = {"sigma_t": 1.2, "sigma_g": 0.5, "kernel": kernel, "boundary": boundary}
    for frames, radius, iterations in ((1, 2, 1), (2, 3, 3), (7, 9, 1), (12, 3, 3)):
        q = smooth_motion(frames=frames, joints=2, rng=rng, step=0.4)
        q, weight = with_pattern(q, pattern, rng)
        assert_agrees(q, weight, radius=radius, iterations=iterations, causal=causal, **options)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_bandwidth_per_joint_is_each_joint_with_its_bandwidth(kernel, rng):
    q = smooth_motion(rng=rng)
    sigmas = {"sigma_t": [0.7, 1.3, 2.1], "sigma_g": [0.2, 0.5, 0.9]}
    together = bilateral_filter(q, radius=4, kernel=kernel, **sigmas)
    alone = reference.every_joint(
        reference.bilateral_filter,
        numpy_of(q),
        np.ones(q.shape[:-1]),
        radius=4,
        kernel=kernel,
        per_joint=sigmas,
    )
    assert_same_rotation(together, torch.from_numpy(alone), 1e-10)


def passes(printed_sign, clean, noisy):
    """Mean squared error [rad^2] before and after each of four passes of the oracle."""
    q, errors = numpy_of(noisy), [float(metrics.mean_squared_error(noisy, clean))]
    for _ in range(4):
        q = reference.every_joint(
            reference.bilateral_filter,
            q,
            np.ones(q.shape[:-1]),
            sigma_t=1.0,
            sigma_g=0.5,
            radius=3,
            printed_sign=printed_sign,
        )
        errors.append(float((angle_between(torch.from_numpy(q), clean) ** 2).mean()))
    return errors


def test_the_printed_sign_of_b_r_raises_the_error_with_each_pass_and_minus_lowers_it(rng):
    clean = smooth_motion(frames=80, joints=1, step=0.01, rng=rng)
    noisy = noise.gaussian(clean, 0.18, generator=rng)
    plus, minus = passes(True, clean, noisy), passes(False, clean, noisy)
    said = f"plus {np.round(plus, 4)}, minus {np.round(minus, 4)} rad^2"
    assert all(np.diff(plus) > 0), said
    assert all(np.diff(minus) < 0), said
    # 3 * 0.18^2 = 0.097 rad^2 of noise: grown by a quarter and more, and taken down to a fifth
    assert plus[-1] > 1.25 * plus[0] and minus[-1] < 0.2 * minus[0], said


def test_an_edge_survives_that_a_gaussian_would_melt(rng):
    """What the filter is for: noise of 0.05 rad goes, a turn of 1.5 rad in one frame stays."""
    clean = torch.zeros(40, 1, 4, dtype=torch.float64)
    clean[:20, 0, 3], clean[20:, 0, 0], clean[20:, 0, 3] = 1.0, np.sin(0.75), np.cos(0.75)
    noisy = noise.gaussian(clean, 0.05, generator=rng)
    q = bilateral_filter(noisy, sigma_t=2.0, sigma_g=0.3)
    gain = float(metrics.psnr(q, clean) - metrics.psnr(noisy, clean))
    step = float(angle_between(q[19], q[20]))
    assert gain > 6.0 and abs(step - 1.5) < 0.1, f"gain {gain:.1f} dB, step {step:.2f} rad"


@pytest.mark.parametrize("kernel", KERNELS)
def test_denoises(kernel, rng):
    gains = []
    for _ in range(5):
        clean = smooth_motion(frames=100, step=0.02, rng=rng)
        noisy = noise.gaussian(clean, 0.1, generator=rng)
        q = bilateral_filter(noisy, sigma_t=2.0, sigma_g=0.5, kernel=kernel)
        gains.append(float(metrics.psnr(q, clean) - metrics.psnr(noisy, clean)))
    gain = sum(gains) / len(gains)
    assert 6.0 < gain < 12.0, f"gain {gain:.2f} dB"


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_radius_0_and_no_iterations_change_nothing(boundary, rng, dtype):
    q = smooth_motion(rng=rng, dtype=dtype)
    same = {"sigma_t": 1.0, "sigma_g": 0.5, "boundary": boundary}
    assert_same_rotation(bilateral_filter(q, radius=0, **same), q)
    assert_same_rotation(bilateral_filter(q, iterations=0, **same), q)


def test_the_hemisphere_is_that_of_the_input_after_two_passes(rng):
    """Where rotations are so wild that two steps lead out of it, which one alone never does."""
    q = random_rotations(60, 3, rng=rng)
    filtered = bilateral_filter(q, sigma_t=3.0, sigma_g=10.0, iterations=2)
    assert ((filtered * q).sum(-1) >= 0.0).all()


def test_a_wide_geodesic_bandwidth_is_a_gaussian_filter(rng):
    q = smooth_motion(rng=rng)
    wide = bilateral_filter(q, sigma_t=1.3, sigma_g=1e6)
    assert_same_rotation(wide, gaussian_filter(q, sigma_t=1.3), 1e-9)


def test_causal_does_not_look_ahead(rng):
    q = smooth_motion(frames=12, rng=rng)
    later = q.clone()
    later[7:] = smooth_motion(frames=5, rng=rng)
    later[9, 1] = torch.nan
    for boundary in BOUNDARIES:
        module = BilateralFilter(1.0, 0.5, causal=True, iterations=3, boundary=boundary)
        assert torch.equal(module(q)[:7], module(later)[:7])


def test_module_is_its_function(rng):
    q = smooth_motion(2, rng=rng)
    weight = torch.rand(q.shape[:-1], generator=rng, dtype=q.dtype)
    options = {
        "radius": 2,
        "kernel": "exponential",
        "iterations": 2,
        "boundary": "circular",
        "causal": True,
    }
    module = BilateralFilter(1.0, [0.5, 0.25, 0.125], **options)
    expected = bilateral_filter(q, weight, sigma_t=1.0, sigma_g=[0.5, 0.25, 0.125], **options)
    assert_same_rotation(module(q, weight), expected, 1e-7)  # bandwidths are kept in float32
    assert BilateralFilter(2.1).radius == 7
    assert "sigma_g=[0.5, 0.25, 0.125]" in repr(module)


@pytest.mark.parametrize("kernel", KERNELS)
def test_gradients_of_signal_weights_and_bandwidths(kernel, rng):
    q = smooth_motion(frames=4, joints=1, rng=rng).requires_grad_()
    weight = (0.2 + torch.rand(4, 1, generator=rng, dtype=torch.float64)).requires_grad_()
    sigma_t = torch.tensor(0.9, dtype=torch.float64, requires_grad=True)
    sigma_g = torch.tensor([0.6], dtype=torch.float64, requires_grad=True)

    def run(q, weight, sigma_t, sigma_g):
        return bilateral_filter(
            q, weight, sigma_t=sigma_t, sigma_g=sigma_g, radius=2, kernel=kernel, iterations=2
        )

    assert gradcheck(run, (q, weight, sigma_t, sigma_g))
    assert gradgradcheck(run, (q, weight, sigma_t, sigma_g), fast_mode=True)


@pytest.mark.parametrize("sigma_g", [0.2, 0.5, 0.8, [0.2, 0.8]], ids=str)
@pytest.mark.parametrize("kernel", KERNELS)
def test_gradients_of_the_signal_where_bandwidths_are_fixed(kernel, sigma_g, rng):
    """What is then written out by hand."""
    q = smooth_motion(frames=6, joints=2, rng=rng).requires_grad_()
    weight = (0.2 + torch.rand(6, 2, generator=rng, dtype=torch.float64)).requires_grad_()

    def run(q, weight):
        return bilateral_filter(q, weight, sigma_t=0.9, sigma_g=sigma_g, kernel=kernel)

    assert gradcheck(run, (q, weight), fast_mode=True)
    assert gradcheck(lambda q: run(q, None), (q,), fast_mode=True)


def test_gradients_of_a_causal_filter_that_holds_the_first_frame(rng):
    """No frame is without weight then, but pairs of frames count in one direction only."""
    q = smooth_motion(frames=6, joints=1, rng=rng).requires_grad_()
    options = {"sigma_t": 0.9, "sigma_g": 0.5, "causal": True, "boundary": "replicate"}
    assert gradcheck(lambda q: bilateral_filter(q, **options), (q,))


def test_gradients_of_turns_of_more_than_half_a_turn_within_the_window(rng):
    """The geodesic between two frames leads the other way than the path."""
    q = smooth_motion(frames=8, joints=1, rng=rng)
    turns = 2.0 * torch.arange(8.0).double()[:, None, None] * torch.tensor([1.0, 0.0, 0.0])
    q = so3.compose(q, so3.exp(turns)).requires_grad_()
    assert gradcheck(lambda q: bilateral_filter(q, sigma_t=1.5, sigma_g=1.0, radius=3), (q,))


@pytest.mark.parametrize("sigma", [0.5, [0.3, 0.5, 0.7]], ids=["one", "per-joint"])
def test_learnable_bandwidths_stay_positive(sigma, rng):
    module = BilateralFilter(sigma, sigma, radius=2, learnable=True)
    q = smooth_motion(rng=rng, dtype=torch.float32, step=0.4)
    target = smooth_motion(rng=rng, dtype=torch.float32)
    metrics.mean_squared_error(module(q), target).backward()
    for parameter in module.parameters():
        assert parameter.grad.isfinite().all() and (parameter.grad != 0).all()
    torch.optim.SGD(module.parameters(), lr=10.0).step()
    assert (module.sigma_t > 0).all() and (module.sigma_g > 0).all()
    fixed = BilateralFilter(sigma, sigma)
    assert not list(fixed.parameters()) and set(fixed.state_dict()) == set(module.state_dict())


def test_training_finds_a_better_bandwidth(rng):
    """As a layer: a few steps of gradient descent on the bandwidths lower the error."""
    clean = smooth_motion(frames=60, step=0.02, rng=rng, dtype=torch.float32)
    noisy = noise.gaussian(clean, 0.1, generator=rng)
    module = BilateralFilter(0.6, 0.1, radius=6, learnable=True)
    optimiser = torch.optim.Adam(module.parameters(), lr=0.1)
    errors = []
    for _ in range(25):
        optimiser.zero_grad()
        error = metrics.mean_squared_error(module(noisy), clean)
        error.backward()
        optimiser.step()
        errors.append(error.item())
    assert errors[-1] < 0.3 * errors[0], f"{errors[0]:.4f} -> {errors[-1]:.4f} rad^2"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma_t": 0.0}, "sigma_t must be finite and > 0, got 0.0"),
        ({"sigma_g": float("nan")}, "sigma_g must be finite and > 0, got nan"),
        ({"sigma_g": [0.1, -0.1]}, "sigma_g must be finite and > 0"),
        ({"radius": -1}, "radius must be >= 0, got -1"),
        ({"kernel": "box"}, "kernel must be one of gaussian, exponential, got 'box'"),
        ({"iterations": -1}, "iterations must be >= 0, got -1"),
        ({"boundary": "wrap"}, "boundary must be one of truncate, .*, got 'wrap'"),
    ],
)
def test_says_what_is_wrong(options, message, rng):
    with pytest.raises(ValueError, match=message):
        BilateralFilter(**options)
    with pytest.raises(ValueError, match=message):
        bilateral_filter(smooth_motion(rng=rng), **{"sigma_t": 1.0, "sigma_g": 0.1, **options})


@pytest.mark.parametrize("options", [{"radius": 1.5}, {"iterations": True}, {"sigma_t": "1"}])
def test_says_what_type_is_wrong(options, rng):
    with pytest.raises(TypeError, match=next(iter(options))):
        BilateralFilter(**options)
