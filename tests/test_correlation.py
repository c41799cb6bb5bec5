"""Correlated noise: the spectrum it has, how surely it is found, and what that gains."""

import math

import numpy as np
import pytest
import reference_spectra as reference
import torch
from motions import angle_between, numpy_of
from test_spectral import swaying

from torchquat import denoise, noise
from torchquat.filters._correlation import noise_of
from torchquat.filters._local_spectra import correlated_power, shrunk, windows_of
from torchquat.filters._moving_frame import rough_motion


def found(q, weight=None):
    return noise_of(q, rough_motion(q, 4), weight)


@pytest.mark.parametrize("size", [1, 2, 7, 64])
def test_power_in_every_coefficient(size):
    basis = windows_of(size, 64, torch.zeros(1, dtype=torch.float64)).basis
    power = correlated_power(basis, torch.tensor([0.0, 0.6], dtype=torch.float64))
    assert torch.equal(power[0], torch.ones(size, dtype=torch.float64))
    assert np.allclose(power[1], reference.correlated_power(size, 0.6), atol=1e-12)


def test_gains_agree_with_plain_loops(rng):
    """Two items, two groups of channels, each with a noise of its own."""
    away, path = torch.randn(2, 2, 20, 6, generator=rng, dtype=torch.float64)
    path = path.cumsum(1)
    windows = windows_of(20, 8, away)
    rho = torch.tensor([[0.0, 0.5], [0.8, 0.3]], dtype=torch.float64)
    power = correlated_power(windows.basis, rho)
    for together in (1, 3):
        actual = shrunk(away, path, windows, together, power)
        for item, group in ((0, 0), (0, 1), (1, 0), (1, 1)):
            part = (item, slice(None), slice(3 * group, 3 * group + 3))
            colour = reference.correlated_power(8, rho[item, group].item())
            seen = numpy_of(away[part]), numpy_of(path[part])
            assert np.allclose(actual[part], reference.shrunk(*seen, 8, together, colour))


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.5])
def test_white_noise_is_white(sigma, rng):
    clean = swaying(joints=8)
    size, rho = found(noise.gaussian(clean, sigma, generator=rng))
    assert (rho == 0).all()
    assert (size / sigma).log().mean().exp().item() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("rho", [0.5, 0.7, 0.9])
@pytest.mark.parametrize("sigma", [0.01, 0.1])
def test_correlation_is_found(rho, sigma, rng):
    """The weakest one that is not ruled out; few and wide movements hide the rest of it."""
    size, seen = found(noise.correlated(swaying(joints=8), sigma, rho=rho, generator=rng))
    assert 0.3 < seen.item() < rho + 0.12
    step = size * (1.0 - seen.square()).sqrt() / (sigma * math.sqrt(1.0 - rho**2))
    assert step.log().mean().exp().item() == pytest.approx(1.0, abs=0.3)


def test_missing_frames_do_not_hide_it(rng):
    q = noise.correlated(swaying(joints=8), 0.05, rho=0.8, generator=rng)
    weight = (torch.rand(200, 8, generator=rng) > 0.2).double()
    assert found(q, weight)[1].item() > 0.3


def test_gains_on_correlated_noise(rng):
    clean = swaying(joints=8)
    noisy = noise.correlated(clean, 0.05, rho=0.8, generator=rng)
    after = angle_between(denoise(noisy), clean).square().mean()
    gain = 10 * (angle_between(noisy, clean).square().mean() / after).log10()
    assert gain > 1.0, f"{gain:.1f} dB"
