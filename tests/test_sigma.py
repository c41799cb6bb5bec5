"""How much noise there is, told from the motion alone: by draws whose size is known."""

import pytest
import torch
from motions import smooth_motion
from test_spectral import swaying

from torchquat import noise
from torchquat.noise.estimate import measured, sizes_of

SIZES = (0.002, 0.01, 0.05, 0.2, 0.6)


def mean_ratio(make, sigma, rng, clips=4):
    """Estimated over true size, the mean over joints and clips."""
    ratios = [noise.estimate_sigma(make(rng)) / sigma for _ in range(clips)]
    return torch.stack(ratios).mean()


@pytest.mark.parametrize("sigma", SIZES)
@pytest.mark.parametrize("frames", [300, 3000], ids=["looked at whole", "looked at in windows"])
def test_within_ten_percent(sigma, frames, rng):
    clean = swaying(frames=frames)
    ratio = mean_ratio(lambda rng: noise.gaussian(clean, sigma, generator=rng), sigma, rng)
    assert 0.9 < ratio < 1.1


def test_every_joint_has_its_own(rng):
    sigma = torch.tensor([0.01, 0.1, 0.4, 0.0], dtype=torch.float64)
    clean = swaying(frames=400)[:, :1].expand(-1, 4, -1)
    found = noise.estimate_sigma(noise.gaussian(clean, sigma, generator=rng))
    assert torch.allclose(found, sigma, rtol=0.15, atol=2e-4)


def test_a_motion_without_noise_has_none():
    assert (noise.estimate_sigma(swaying(frames=300)) < 2e-4).all()


def test_outliers_and_flips_hardly_count(rng):
    q = noise.gaussian(swaying(frames=400), 0.05, generator=rng)
    wild = noise.flip_signs(noise.impulse(q, 1.0, generator=rng), generator=rng)
    assert torch.allclose(noise.estimate_sigma(wild), noise.estimate_sigma(q), rtol=0.15)


def test_a_burst_of_motion_hardly_counts(rng):
    """A third of the frames shakes; the noise is told from the others."""
    clean = swaying(frames=600)
    clean[200:400] = noise.gaussian(clean[200:400], 0.5, generator=rng)
    assert torch.allclose(
        noise.estimate_sigma(noise.gaussian(clean, 0.02, generator=rng)),
        torch.full((clean.shape[1],), 0.02, dtype=clean.dtype),
        rtol=0.25,
    )


@pytest.mark.parametrize("stretch", [1, 7], ids=["scattered", "in stretches"])
def test_A13_missing_frames_do_not_count(stretch, rng):
    clean = swaying(frames=420)
    q = noise.gaussian(clean, 0.05, generator=rng)
    gone = (torch.rand(60, clean.shape[1], generator=rng) < 0.3).repeat_interleave(7, 0)
    if stretch == 1:
        gone = torch.rand(gone.shape, generator=rng) < 0.3
    masked = noise.estimate_sigma(q, (~gone).to(q.dtype))
    q[gone] = torch.nan
    assert torch.equal(noise.estimate_sigma(q), masked)
    assert torch.allclose(masked.mean(), masked.new_tensor(0.05), rtol=0.15)


@pytest.mark.parametrize("frames", [0, 1, 2, 3, 5])
def test_B1_B2_too_few_frames_tell_nothing(frames, rng):
    q = smooth_motion(2, frames=frames, rng=rng)
    assert torch.equal(noise.estimate_sigma(q), torch.zeros(2, q.shape[-2], dtype=q.dtype))


def test_time_and_signs_have_no_direction(rng):
    q = noise.gaussian(swaying(frames=300), 0.1, generator=rng)
    found = noise.estimate_sigma(q)
    assert torch.allclose(noise.estimate_sigma(q.flip(-3)), found, rtol=1e-6)
    assert torch.allclose(noise.estimate_sigma(-q), found, rtol=1e-12)


@pytest.mark.parametrize("rho", [0.5, 0.9])
def test_noise_that_lasts_is_seen_if_its_correlation_is_known(rho, rng):
    ratios = []
    for _ in range(6):
        q = noise.correlated(swaying(frames=600), 0.1, rho=rho, generator=rng)
        ratios.append(sizes_of(measured(q, None).estimates, (rho,))[0] / 0.1)
    assert 0.85 < torch.stack(ratios).mean() < 1.15
