"""The call without parameters: what it gains, what it leaves alone."""

import pytest
import torch
from motions import angle_between, assert_same_rotation, smooth_motion
from test_spectral import swaying

from torchquat import AutoDenoiser, denoise, noise, repair, so3
from torchquat.filters._correlation import noise_of, rounded
from torchquat.filters._mixture import mixture
from torchquat.filters._moving_frame import rough_motion
from torchquat.filters._whitened import mean_size, stretch_of
from torchquat.noise._principal import principal
from torchquat.noise.estimate import measured


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.5])
def test_gains_without_being_told_the_noise(sigma, rng):
    clean = swaying()
    noisy = noise.gaussian(clean, sigma, generator=rng)
    after = angle_between(denoise(noisy), clean)
    ratio = angle_between(noisy, clean).square().mean() / after.square().mean()
    assert 10 * ratio.log10() > 6.0, f"{10 * ratio.log10():.1f} dB"


def test_leaves_clean_motion_alone():
    clean = swaying()
    assert angle_between(denoise(clean), clean).mean() < 1e-5


def shaken(rng):
    """Much more noise about one axis, and wild samples of one joint."""
    size = torch.tensor([0.05, 0.4, 0.05], dtype=torch.float64)
    v = size * torch.randn(200, 3, 3, generator=rng, dtype=torch.float64)
    q = so3.turn(swaying(), v)
    q[50:150:4, 0] = so3.turn(q[50:150:4, 0], torch.tensor([2.5, 0.0, 0.0], dtype=torch.float64))
    return q


def spoiled(rng):
    """Some noise, and wild samples."""
    return noise.impulse(noise.gaussian(swaying(), 0.02, generator=rng), 1.0, generator=rng)


def lasting(rng):
    """Noise that lasts from frame to frame."""
    return noise.correlated(swaying(), 0.05, rho=0.8, generator=rng)


def dragged(rng):
    """Noise of both kinds: that it lasts is not told if it is taken for alike about all axes."""
    slow = noise.correlated(swaying(), 0.4, rho=0.8, generator=rng)
    share = torch.tensor([0.125, 1.0, 0.125], dtype=torch.float64)
    return so3.turn(swaying(), share * so3.log(so3.relative(swaying(), slow)))


def noisy(rng):
    """So much noise that every sample would be taken for wild if its size were not known."""
    return noise.gaussian(swaying(), 0.6, generator=rng)


@pytest.mark.parametrize(
    ("make", "missing"),
    [(shaken, 0.0), (spoiled, 0.0), (noisy, 0.0), (lasting, 0.4), (dragged, 0.0)],
)
def test_one_step_after_the_other(make, missing, rng):
    """Wild samples by the size of the noise; the noise again, without them; then the mixture."""
    q, weight = make(rng), torch.rand(200, 3, generator=rng, dtype=torch.float64)
    weight[torch.rand(200, 3, generator=rng) < missing] = 0.0
    sigma = rounded(noise.estimate_sigma(q))
    stretch = stretch_of(principal(measured(q, None).found), sigma)
    assert (stretch is not None) == (make in (shaken, dragged))
    repaired, trust = repair(q, weight, sigma=mean_size(sigma, stretch))
    seen = measured(repaired, trust)
    stretch = stretch_of(principal(seen.found), rounded(noise.estimate_sigma(repaired, trust)))
    motion = rough_motion(repaired, 4)
    size, rho = noise_of(repaired, motion, trust, seen, stretch)
    expected = mixture(repaired, weight, size, rho, motion, stretch)
    assert_same_rotation(denoise(q, weight), expected)
    assert (make in (shaken, spoiled)) == bool(((trust == 0) & (weight > 0)).any())


def test_axes_are_each_motions_own(rng):
    """In a batch of a motion that trembles about one axis, and one that does not."""
    batch = torch.stack([shaken(rng), lasting(rng)])
    assert_same_rotation(denoise(batch), torch.stack([denoise(q) for q in batch]))


def test_strength_walks_along_the_geodesic(rng):
    q = noise.gaussian(swaying(), 0.1, generator=rng)
    full = denoise(q)
    half = denoise(q, strength=0.5)
    assert_same_rotation(half, so3.midpoint(q, full))
    assert torch.equal(denoise(3.0 * q, strength=0.0), 3.0 * q)
    assert torch.equal(AutoDenoiser(0.5)(q), half)


def test_arguments(rng):
    q = smooth_motion(rng=rng)
    for strength, error, message in (
        (-0.1, ValueError, r"strength must lie in \[0, 1\], got -0\.1\."),
        (1.5, ValueError, r"strength must lie in \[0, 1\], got 1\.5\."),
        (float("nan"), ValueError, r"strength must lie in \[0, 1\], got nan\."),
        ("all", TypeError, r"strength must be a number, got 'all'\."),
    ):
        with pytest.raises(error, match=message):
            AutoDenoiser(strength)
        with pytest.raises(error, match=message):
            denoise(q, strength=strength)
    assert "strength=0.5" in repr(AutoDenoiser(0.5))
