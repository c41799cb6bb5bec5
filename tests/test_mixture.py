"""The mixture of estimates: agreement with plain loops, Stein's estimate of the risk."""

import numpy as np
import pytest
import reference_mixture as reference
import torch
from motions import angle_between, assert_same_rotation, numpy_of, smooth_motion
from test_spectral import swaying

from torchquat import local_spectrum_filter, low_rank_filter, noise
from torchquat.filters import _hankel, _local_spectra
from torchquat.filters._mixing import Estimate, mixed
from torchquat.filters._mixture import mixture
from torchquat.filters._moving_frame import rough_motion
from torchquat.filters._whitened import Stretch


@pytest.mark.parametrize(("frames", "rho"), [(13, 0.0), (90, 0.0), (50, 0.7), (2, 0.5)])
def test_agrees_with_plain_loops(frames, rho, rng):
    q = smooth_motion(frames=frames, joints=2, step=0.4, rng=rng)
    weight = 0.2 + torch.rand(frames, 2, generator=rng, dtype=torch.float64)
    sigma, motion = torch.tensor([0.2, 0.3], dtype=torch.float64), rough_motion(q, 4)
    found = mixture(q, weight, sigma, torch.tensor([rho], dtype=torch.float64), motion)
    trust = numpy_of(weight / weight.amax(0))
    expected = reference.mixture(numpy_of(q), trust, (0.2, 0.3), rho, numpy_of(motion))
    assert_same_rotation(found, torch.from_numpy(expected), 1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_freedom_of_spectra_is_the_slope_of_the_estimate(rho, rng):
    """Numerical derivatives by the coefficients, gains included, weighed by their noise."""
    x = 3.0 * torch.randn(1, 24, 3, generator=rng, dtype=torch.float64).cumsum(1)
    still = torch.zeros_like(x)
    windows = _local_spectra.windows_of(24, 24, x)
    power = _local_spectra.correlated_power(
        windows.basis, torch.tensor([[rho]], dtype=torch.float64)
    )

    def estimate(x):
        return _local_spectra.shrunk(x, still, windows, 1, power)

    total, step = 0.0, 1e-5
    for k, cosine in enumerate(windows.basis):
        for axis in range(3):
            bump = step * cosine[:, None] * torch.eye(3).double()[axis]
            rise = (estimate(x + bump) - estimate(x - bump))[0, :, axis] @ cosine / (2.0 * step)
            total += float(power[0, 0, k] * rise)
    freedom = _local_spectra.shrunk_with_freedom(x, still, windows, power)[1]
    assert float(freedom.sum()) == pytest.approx(total, rel=1e-6)


def test_freedom_of_low_rank_is_the_slope_of_the_estimate(rng):
    """The formula holds for matrices without structure: one frame a row."""
    modes = torch.randn(2, 30, generator=rng, dtype=torch.float64)
    x = torch.randn(1, 40, 2, generator=rng, dtype=torch.float64) @ (5.0 * modes)
    x = x + torch.randn(x.shape, generator=rng, dtype=torch.float64)
    still, count = torch.zeros_like(x), torch.tensor([30])

    def estimate(x):
        return _hankel.smoothed(x, still, 1, count, 64)

    total, step = 0.0, 1e-5
    bump = torch.zeros_like(x)
    for place in range(x.numel()):
        bump.flatten()[place] = step
        ends = [estimate(x + s * bump)[0] for s in (1, -1)]
        total += float((ends[0] - ends[1]).flatten()[place]) / (2.0 * step)
        bump.flatten()[place] = 0.0
    chosen = estimate(x)[1]
    white = torch.eye(1, 40, dtype=torch.float64)
    freedom = 30.0 * _hankel.freedom(chosen, x.shape, white).sum()
    constant = 30.0 * _hankel.freedom(chosen._replace(ratio=torch.ones(2)), x.shape, white).sum()
    assert float(freedom) == pytest.approx(total, rel=0.02)
    assert float(constant) < 0.8 * total


@pytest.mark.parametrize("scale", [0.1, 0.5, 1.5, "barely"])
def test_freedom_of_low_rank_agrees_with_plain_loops(scale, rng):
    """Where much, little, next to nothing or nothing stands out of the noise, which lasts."""
    data = torch.randn(2, 26, 6, generator=rng, dtype=torch.float64).cumsum(1)
    data *= _barely(data[0]) if scale == "barely" else scale
    lag = torch.arange(26, dtype=torch.float64)
    rho = torch.tensor([[0.0], [0.7]], dtype=torch.float64)
    colour = torch.where(lag == 0, 1.0, rho**lag)
    still, count = torch.zeros_like(data), torch.tensor([6, 6])
    chosen = _hankel.smoothed(data, still, 4, count, 26)[1]
    found = _hankel.freedom(chosen, data.shape, colour)
    for item in range(2):
        seen = numpy_of(data[item] - data[item].mean(0))
        expected = reference.freedom_of_low_rank(seen, 4, rho[item, 0].item())
        assert torch.allclose(found[item, :, 0], torch.from_numpy(expected), rtol=1e-9)


def _barely(data):
    """What to multiply data by, so that of the largest component alone a hundredth is kept."""
    seen = numpy_of(data - data.mean(0))
    hankel = np.array([seen[row : row + 4].flatten() for row in range(23)])
    return np.sqrt(24.0 * 1.0002) * (1.0 + np.sqrt(23 / 24)) / np.linalg.norm(hankel, 2)


def test_share_goes_no_further_than_the_next_estimate(rng):
    """Which lies halfway to data without noise: the whole way is better than that."""
    x = 5.0 * torch.randn(50, 2, 3, generator=rng, dtype=torch.float64)
    none = torch.zeros(50, 2, dtype=torch.float64)
    estimates = [Estimate(part * x, none) for part in (0.0, 0.5)]
    assert torch.equal(mixed(estimates, x, none + 1.0), 0.5 * x)
    estimates.reverse()  # away from the data: not at all
    assert torch.equal(mixed(estimates, x, none + 1.0), 0.5 * x)


def test_confidences_that_are_alike_change_nothing(rng):
    """With noise that is larger about some axes, too."""
    q = smooth_motion(frames=60, joints=2, step=0.2, rng=rng)
    axes = torch.linalg.qr(torch.randn(2, 3, 3, generator=rng, dtype=torch.float64))[0]
    stretch = Stretch(axes, torch.tensor([[1.0, 2.0, 4.0], [1.0, 1.0, 6.0]]).double())
    size, white = torch.tensor([0.05, 0.1]).double(), torch.zeros(1, dtype=torch.float64)
    known = size, white, rough_motion(q, 4)
    alike = mixture(q, torch.full((60, 2), 0.3, dtype=torch.float64), *known, stretch)
    assert_same_rotation(alike, mixture(q, None, *known, stretch), 1e-12)
    assert angle_between(alike, mixture(q, None, *known)).mean() > 0.01


def test_share_is_that_of_james_and_stein(rng):
    """From the data themselves towards zero: 1 - 3 T / |x|^2 is left."""
    x = 2.0 * torch.randn(200, 1, 3, generator=rng, dtype=torch.float64)
    everything = Estimate(x, torch.full((200, 1), 3.0, dtype=torch.float64))
    nothing = Estimate(torch.zeros_like(x), torch.zeros(200, 1, dtype=torch.float64))
    left = mixed([everything, nothing], x, torch.ones(200, 1, dtype=torch.float64)) / x
    assert torch.allclose(left, 1.0 - 600.0 / x.square().sum(), atol=0.5 / 256)


def test_no_worse_than_what_it_mixes(rng):
    """Quiet and loud joints, slow and sudden motion."""
    clean = torch.cat([swaying(300, 3), smooth_motion(frames=300, joints=3, step=0.1, rng=rng)], 1)
    sigma = torch.tensor([0.02, 0.1, 0.4, 0.02, 0.1, 0.4], dtype=torch.float64)
    noisy = noise.gaussian(clean, sigma, generator=rng)
    white = torch.zeros(1, dtype=torch.float64)
    found = {
        "mixture": mixture(noisy, None, sigma, white, rough_motion(noisy, 4)),
        "short": local_spectrum_filter(noisy, window=40, sigma=sigma.tolist()),
        "long": local_spectrum_filter(noisy, window=192, sigma=sigma.tolist()),
        "low rank": low_rank_filter(noisy, window=6, sigma=sigma.tolist()),
    }
    error = {name: float(angle_between(q, clean).square().mean()) for name, q in found.items()}
    others = [error[name] for name in ("short", "long", "low rank")]
    assert error["mixture"] < 1.02 * min(others), error
