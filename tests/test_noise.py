"""Noise has the size that it says."""

import pytest
import torch
from motions import random_rotations

from torchquat import noise, so3


def test_sigma_is_that_of_each_component_of_the_rotation_vector(rng, dtype):
    q = random_rotations(20000, 1, rng=rng, dtype=dtype)
    v = so3.log(so3.relative(q, noise.gaussian(q, 0.18, generator=rng)))
    # 20000 draws: the standard deviation is known to 0.5 %, four times that is allowed
    assert torch.allclose(v.std(0), torch.full((1, 3), 0.18, dtype=dtype), rtol=0.02)
    assert v.mean(0).abs().max() < 4 * 0.18 / 20000**0.5


def test_sigma_per_joint(rng):
    q = random_rotations(5000, 3, rng=rng)
    noisy = noise.gaussian(q, [0.0, 0.1, 0.2], generator=rng)
    v = so3.log(so3.relative(q, noisy))
    assert v[:, 0].abs().max() < 1e-15
    assert v[:, 2].std() / v[:, 1].std() == pytest.approx(2.0, rel=0.05)


def test_the_generator_decides(rng):
    q = random_rotations(9, 2, rng=rng)
    draws = [noise.gaussian(q, 0.1, generator=torch.Generator().manual_seed(3)) for _ in range(2)]
    assert torch.equal(*draws)


@pytest.mark.parametrize("sigma", [-0.1, float("nan"), [0.1, float("inf")]])
def test_A23_says_what_is_wrong(sigma, rng):
    with pytest.raises(ValueError, match="sigma must be finite and >= 0, got"):
        noise.gaussian(random_rotations(4, 2, rng=rng), sigma)


def test_impulses_turn_a_share_of_all_samples(rng, dtype):
    q = random_rotations(20000, 2, rng=rng, dtype=dtype)
    v = so3.log(so3.relative(q, noise.impulse(q, 0.5, generator=rng)))
    turned = v.norm(dim=-1) > 1e-3
    assert turned.double().mean().item() == pytest.approx(0.05, rel=0.1)
    # 2000 draws: the standard deviation is known to 1.6 %, four times that is allowed
    assert torch.allclose(v[turned].std(0), torch.full((3,), 0.5, dtype=dtype), rtol=0.07)
    none, everyone = (noise.impulse(q, 0.5, share=share, generator=rng) for share in (0.0, 1.0))
    assert so3.distance(q, none).max() < 1e-5
    assert (so3.distance(q, everyone) > 1e-3).double().mean() > 0.99


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_A23_impulse_says_what_is_wrong(share, rng):
    with pytest.raises(ValueError, match=r"share must be in \[0, 1\], got"):
        noise.impulse(random_rotations(4, 2, rng=rng), 0.5, share=share)
