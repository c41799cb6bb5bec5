"""Local spectra: agreement with plain loops, what stays as it is, what is gained."""

import numpy as np
import pytest
import reference_spectra as reference
import torch
from motions import IDENTITY, angle_between, assert_same_rotation, numpy_of, smooth_motion

from torchquat import LocalSpectrumFilter, local_spectrum_filter, noise, so3
from torchquat.filters._correlation import noise_of
from torchquat.filters._moving_frame import rough_motion


def swaying(frames=200, joints=3, amplitude=0.6):
    """A slow, smooth motion ``(T, J, 4)``."""
    t = torch.linspace(0.0, 1.0, frames, dtype=torch.float64)[:, None, None]
    phase = torch.arange(3 * joints, dtype=torch.float64).reshape(joints, 3)
    return so3.exp(amplitude * torch.sin(6.0 * t * (1.0 + 0.2 * phase) + phase))


@pytest.mark.parametrize(("frames", "window"), [(13, 6), (7, 64), (2, 5), (30, 17)])
def test_agrees_with_plain_loops(frames, window, rng):
    q = smooth_motion(frames=frames, joints=2, step=0.4, rng=rng)
    weight = 0.2 + torch.rand(frames, 2, generator=rng, dtype=torch.float64)
    found = local_spectrum_filter(q, weight, window=window, sigma=[0.2, 0.3])
    for joint, sigma in enumerate((0.2, 0.3)):
        trust = numpy_of(weight[:, joint] / weight[:, joint].max())
        expected = reference.local_spectrum(numpy_of(q[:, joint]), trust, sigma, window)
        assert_same_rotation(found[:, joint], torch.from_numpy(np.array(expected)), 1e-10)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_noise_that_is_found_is_the_noise_that_is_removed(rho, rng):
    """Its size and its correlation, as the oracle removes them."""
    clean = swaying(120, 2)
    q = noise.correlated(clean, 0.05, rho=rho, generator=rng)
    size, found = noise_of(q, rough_motion(q, 4), None)
    assert (found.item() > 0.0) == (rho > 0.0)
    result = local_spectrum_filter(q, window=30)
    for joint, sigma in enumerate(size.tolist()):
        seen = numpy_of(q[:, joint]), np.ones(120), sigma, 30, found.item()
        assert_same_rotation(result[:, joint], torch.from_numpy(reference.local_spectrum(*seen)))


@pytest.mark.parametrize("frames", [1, 2, 5, 63, 64, 65, 72, 200])
def test_windows_lie_evenly_and_everywhere(frames):
    from torchquat.filters._local_spectra import windows_of

    seen = windows_of(frames, 64, torch.zeros(1)).frame
    assert set(seen.flatten().tolist()) == set(range(frames))
    starts = seen[:, 0].tolist()[:: 2 if frames <= 64 else 1]
    assert starts == reference.window_starts(frames, 64)[1]
    assert max(np.diff(starts), default=0) <= 16


@pytest.mark.parametrize(("sigma", "gain"), [(0.01, 6.0), (0.1, 11.0), (0.5, 12.0)])
def test_gains_on_noise_of_any_size(sigma, gain, rng):
    clean = swaying()
    noisy = noise.gaussian(clean, sigma, generator=rng)
    for given in (None, sigma):
        after = angle_between(local_spectrum_filter(noisy, sigma=given), clean)
        ratio = angle_between(noisy, clean).square().mean() / after.square().mean()
        assert 10 * ratio.log10() > gain, f"{10 * ratio.log10():.1f} dB"


def test_a_frame_of_half_the_weight_counts_less(rng):
    clean = swaying()
    noisy = noise.gaussian(clean, 0.05, generator=rng)
    weight = torch.ones(200, 3, dtype=torch.float64)
    worse = so3.turn(noisy[90:110], torch.full((3,), 0.1, dtype=torch.float64))
    spoiled = torch.cat([noisy[:90], worse, noisy[110:]])
    errors = []
    for trust in (1.0, 0.3, 0.0):
        weight[90:110] = trust
        result = local_spectrum_filter(spoiled, weight, sigma=0.05)
        errors.append(angle_between(result, clean)[90:110].square().mean())
    assert errors[0] > errors[1] > errors[2]


def test_gradient_is_that_of_the_chosen_linear_filter(rng):
    """Rows of the smoother sum to one: a turn of all frames turns the result."""
    q = so3.turn(IDENTITY, 0.01 * torch.randn(20, 1, 3, generator=rng, dtype=torch.float64))
    v = torch.zeros(20, 1, 3, dtype=torch.float64)

    def moved(v):
        return so3.between(q, local_spectrum_filter(so3.turn(q, v), sigma=0.01))

    slope = torch.autograd.functional.jacobian(moved, v).sum(3).reshape(20, 3, 3)
    assert (slope - torch.eye(3)).abs().max() < 0.05
    assert torch.func.jacrev(moved)(v).isfinite().all()


def test_module_and_arguments(rng):
    q = smooth_motion(rng=rng)
    run = LocalSpectrumFilter(16, sigma=[0.1, 0.2, 0.3])
    assert torch.equal(run(q), local_spectrum_filter(q, window=16, sigma=[0.1, 0.2, 0.3]))
    assert "window=16, sigma=[0.1, 0.2, 0.3]" in repr(run)
    for window, sigma, error, message in (
        (1, None, ValueError, r"window must be >= 2, got 1\."),
        (8.0, None, TypeError, r"window must be an integer, got 8\.0\."),
        (8, 0.0, ValueError, r"sigma must be finite and > 0, got 0\.0\."),
        (8, float("nan"), ValueError, r"sigma must be finite and > 0, got nan\."),
    ):
        with pytest.raises(error, match=message):
            LocalSpectrumFilter(window, sigma=sigma)
        with pytest.raises(error, match=message):
            local_spectrum_filter(q, window=window, sigma=sigma)
    with pytest.raises(ValueError, match=r"sigma must be one value or one per joint \(3\)"):
        local_spectrum_filter(q, sigma=[0.1, 0.2])
