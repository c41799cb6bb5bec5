"""The call without parameters: what it gains, what it leaves alone."""

import pytest
import torch
from motions import angle_between, assert_same_rotation, smooth_motion
from test_spectral import swaying

from torchquat import AutoDenoiser, denoise, noise, so3


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
