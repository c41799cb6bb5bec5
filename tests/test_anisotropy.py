"""Noise larger about one axis of a joint than about others, as a camera sees it in depth."""

import torch
from motions import angle_between
from test_spectral import swaying

from torchquat import denoise, noise, so3
from torchquat.filters import auto
from torchquat.filters._whitened import (
    Stretch,
    in_radians,
    in_units,
    mean_size,
    stretch_of,
    units_of,
)
from torchquat.noise._principal import Principal, principal
from torchquat.noise.estimate import measured


def about_one_axis(q, large, small, rng):
    """Noise with standard deviation ``large`` about a skew axis, ``small`` about all others."""
    axis = torch.tensor([0.6, 0.0, 0.8], dtype=q.dtype)
    step = small * torch.randn((*q.shape[:-1], 3), generator=rng, dtype=q.dtype)
    more = (large**2 - small**2) ** 0.5 * torch.randn(q.shape[:-1], generator=rng, dtype=q.dtype)
    return so3.compose(q, so3.exp(step + more[..., None] * axis)), axis


def test_axes_and_sizes_are_found(rng):
    q, axis = about_one_axis(swaying(frames=600), 0.1, 0.01, rng)
    found = principal(measured(q, None).found)
    assert ((found.axes[..., 2] * axis).sum(-1).abs() > 0.99).all()
    assert torch.allclose(found.size[..., 2], torch.tensor(0.1, dtype=q.dtype), rtol=0.2)
    assert torch.allclose(found.size[..., :2], torch.tensor(0.01, dtype=q.dtype), rtol=0.35)


def test_outliers_do_not_move_the_sizes(rng):
    q, _ = about_one_axis(swaying(frames=600), 0.1, 0.01, rng)
    wild = noise.impulse(q, 0.02, generator=rng)
    before, after = (principal(measured(each, None).found).size[..., 2] for each in (q, wild))
    assert torch.allclose(after, before, rtol=0.15)


def test_it_is_removed(rng, monkeypatch):
    clean = swaying(frames=300)
    noisy, _ = about_one_axis(clean, 0.1, 0.005, rng)
    after = angle_between(denoise(noisy), clean).square().mean()
    monkeypatch.setattr(auto, "stretch_of", lambda *_: None)
    alike = angle_between(denoise(noisy), clean).square().mean()
    before = angle_between(noisy, clean).square().mean()
    assert 10 * torch.log10(before / after) > 8.0
    assert 10 * torch.log10(alike / after) > 3.0  # what it is worth to look at the axes


def test_noise_alike_about_all_axes_is_not_stretched(rng):
    q = noise.gaussian(swaying(frames=300), 0.1, generator=rng)
    seen = measured(q, None)
    assert stretch_of(principal(seen.found), noise.estimate_sigma(q)) is None


def test_noise_is_larger_only_beyond_rough_motion_and_doubt():
    """About an axis: squares less 0.03^2 rad, less two standard errors; never without noise."""
    size = torch.tensor([[0.05, 0.1, 0.2], [0.05, 0.1, 0.2], [0.031, 0.031, 0.2]]).double()
    error = torch.tensor([0.0, 0.3, 0.0]).double()
    axes = torch.eye(3, dtype=torch.float64).expand(3, 3, 3)
    sigma = torch.tensor([0.04, 0.04, 0.01]).double()
    factor = stretch_of(Principal(axes, size, error), sigma).factor
    squares = size.square() - 0.03**2
    expected = (squares / sigma.square()[:, None]).sqrt()
    expected[0, 0] = expected[1, 0] = expected[1, 1] = expected[2, :2] = 1.0
    assert torch.allclose(factor, expected)
    assert stretch_of(Principal(axes, size, error), torch.zeros(3).double()) is None
    mean = mean_size(sigma, Stretch(axes, factor))
    assert torch.allclose(mean, sigma * (factor.square().sum(-1) / 3).sqrt())


def test_units_and_back(rng):
    sigma = torch.tensor([0.1, 0.2, 0.0], dtype=torch.float64)
    axes = torch.linalg.qr(torch.randn(3, 3, 3, generator=rng, dtype=torch.float64))[0]
    factor = torch.tensor([[1.0, 2.0, 5.0], [1.0, 1.0, 1.0], [1.0, 3.0, 1.0]], dtype=torch.float64)
    v = torch.randn(7, 3, 3, generator=rng, dtype=torch.float64)
    units = units_of(sigma, None, Stretch(axes, factor))
    u = in_units(v, units)
    assert torch.allclose(in_radians(u, units), v, atol=1e-14)
    assert torch.equal(u[:, 1], v[:, 1] / 0.2)  # to the last bit where all axes are alike
    third = (v[:, 0] * axes[0, :, 2]).sum(-1) / (5.0 * 0.1)
    assert torch.allclose((u[:, 0] * axes[0, :, 2]).sum(-1), third)
