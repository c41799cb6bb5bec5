"""Correlated noise: the spectrum it has, how surely it is found, and what that gains."""

import math

import numpy as np
import pytest
import reference_correlation
import reference_spectra as reference
import torch
from motions import angle_between, numpy_of
from test_spectral import swaying

from torchquat import denoise, noise
from torchquat.filters import _correlation
from torchquat.filters._correlation import RHOS, noise_of
from torchquat.filters._local_spectra import correlated_power, shrunk, windows_of
from torchquat.filters._moving_frame import rough_motion
from torchquat.filters._whitened import Stretch
from torchquat.noise.estimate import measured, sizes_of


def found(q, weight=None):
    return noise_of(q, rough_motion(q, 4), weight)


@pytest.mark.parametrize("size", [1, 2, 7, 64])
def test_power_in_every_coefficient(size):
    basis = windows_of(size, 64, torch.zeros(1, dtype=torch.float64)).basis
    power = correlated_power(basis, torch.tensor([0.0, 0.6], dtype=torch.float64))
    assert torch.equal(power[0], torch.ones(size, dtype=torch.float64))
    assert np.allclose(power[1], reference.correlated_power(size, 0.6), atol=1e-12)


@pytest.mark.parametrize("compiling", [False, True])
def test_gains_agree_with_plain_loops(compiling, rng, monkeypatch):
    """Two items, two groups of channels, each with a noise of its own."""
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: compiling)
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


@pytest.mark.parametrize("frames", [1, 3, 10, 64, 65, 200, 4200])
def test_evidence_agrees_with_plain_loops(frames, rng):
    """Missing frames, a joint mostly missing, one without noise; noise larger about some axes."""
    joints = 1 if frames > 1000 else 4
    q = noise.gaussian(swaying(frames, joints), 0.1, generator=rng)
    motion = rough_motion(q, 4)
    present = torch.rand(frames, joints, generator=rng) > 0.2
    sigma = 0.05 + torch.rand(len(RHOS), joints, generator=rng, dtype=torch.float64)
    if joints > 1:
        present[: 2 * frames // 3, 1] = False
        sigma[4, 2] = 0.0
    axes = torch.linalg.qr(torch.randn(joints, 3, 3, generator=rng, dtype=torch.float64))[0]
    factor = 1.0 + torch.rand(joints, 3, generator=rng, dtype=torch.float64)
    for stretch in (None, Stretch(axes, factor)):
        found = _correlation._evidence(q, motion, 0.5 * present, sigma, stretch)
        plain = None if stretch is None else tuple(numpy_of(x) for x in stretch)
        seen = (numpy_of(x) for x in (q, motion, present, sigma))
        expected = reference_correlation.evidence(*seen, RHOS, plain)
        assert np.allclose(found, expected, rtol=1e-9, atol=1e-8)


def test_the_weakest_correlation_that_is_not_ruled_out(rng):
    """As the oracle's likelihoods tell, for two clips at once."""
    clean = torch.stack([swaying(150, 3), swaying(150, 3, amplitude=0.2)])
    q = torch.stack(
        [
            noise.gaussian(clean[0], 0.1, generator=rng),
            noise.correlated(clean[1], 0.05, rho=0.8, generator=rng),
        ]
    )
    motion, present = rough_motion(q, 4), np.ones((150, 3))
    sizes = sizes_of(measured(q, None).estimates, RHOS)
    found, rhos = noise_of(q, motion, None)
    for clip in range(2):
        seen = numpy_of(q[clip]), numpy_of(motion[clip]), present, numpy_of(sizes[:, clip])
        likelihood = reference_correlation.evidence(*seen, RHOS)
        chosen = next(r for r, x in enumerate(likelihood) if x >= max(likelihood) - 40.0)
        assert rhos[clip].item() == RHOS[chosen]
        assert torch.allclose(found[clip], sizes[chosen, clip], rtol=2.0**-8)
        digits = 256.0 * torch.frexp(found[clip]).mantissa
        assert torch.equal(digits, digits.round())


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
