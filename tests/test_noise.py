"""Noise has the size that it says."""

import pytest
import torch
from motions import angle_between, assert_same_rotation, random_rotations, smooth_motion
from scipy.spatial.transform import Rotation

from torchquat import noise, so3, validity

KINDS = {
    "gaussian": lambda q, **options: noise.gaussian(q, 0.1, **options),
    "impulse": lambda q, **options: noise.impulse(q, 0.1, **options),
    "correlated": lambda q, **options: noise.correlated(q, 0.1, **options),
    "pops": lambda q, **options: noise.pops(q, 0.1, **options),
    "dropout": noise.dropout,
    "flip_signs": noise.flip_signs,
    "quantise": lambda q, generator=None: noise.quantise(q, 0.01),
    "quantise-euler": lambda q, generator=None: noise.quantise(q, 0.01, axes="ZXY"),
}


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


@pytest.mark.parametrize("kind", KINDS)
def test_the_generator_decides(kind, rng):
    q = random_rotations(9, 2, rng=rng)
    before = q.clone()
    draws = [KINDS[kind](q, generator=torch.Generator().manual_seed(3)) for _ in range(2)]
    assert torch.equal(draws[0].nan_to_num(), draws[1].nan_to_num())
    assert torch.equal(q, before), "the input was written to"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [(0, 2), (1, 2), (2, 2), (3, 0), (2, 3, 5, 2), (0, 4, 1)])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16])
def test_B1_B2_B9_shapes_and_dtypes_are_kept(kind, shape, dtype, rng):
    q = random_rotations(*shape, rng=rng).to(dtype)
    result = KINDS[kind](q, generator=rng)
    assert result.shape == q.shape and result.dtype == dtype


@pytest.mark.parametrize("kind", KINDS)
def test_A14_missing_frames_stay_missing_and_alone(kind, rng):
    q = random_rotations(30, 2, rng=rng)
    spoiled = q.clone()
    spoiled[4, 0, 2] = torch.nan
    spoiled[9, 1] = 0.0
    result, whole = (
        KINDS[kind](each, generator=torch.Generator().manual_seed(3)) for each in (spoiled, q)
    )
    present = validity(spoiled)
    assert not validity(result)[~present].any()
    assert torch.equal(result[present].nan_to_num(), whole[present].nan_to_num())


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


def test_correlated_noise_is_stationary_with_the_correlation_it_says(rng):
    q = random_rotations(2000, 60, rng=rng)
    v = so3.between(q, noise.correlated(q, 0.1, rho=0.8, generator=rng))
    # 10000 independent draws at each end
    for part in (v[:50:8], v[-50::8]):
        assert part.std().item() == pytest.approx(0.1, rel=0.07)
    assert v.std().item() == pytest.approx(0.1, rel=0.02)
    for lag in (1, 2, 5):
        correlation = (v[lag:] * v[:-lag]).mean() / v.square().mean()
        assert correlation.item() == pytest.approx(0.8**lag, abs=0.03)


def test_correlated_noise_agrees_with_its_recursion(rng):
    q = random_rotations(37, 2, rng=rng)
    draws = [torch.Generator().manual_seed(5) for _ in range(2)]
    n = so3.between(q, noise.correlated(q, 0.1, rho=0.0, generator=draws[0]))
    v = [n[0]]
    for t in range(1, 37):
        v.append(-0.6 * v[-1] + 0.8 * n[t])
    actual = so3.between(q, noise.correlated(q, 0.1, rho=-0.6, generator=draws[1]))
    assert torch.allclose(actual, torch.stack(v), atol=1e-12)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_pops_stay_for_a_while(share, rng):
    q = random_rotations(1, 60, rng=rng).expand(3000, 60, 4)
    popped = noise.pops(q, 0.5, share=share, length=(5, 15), generator=rng)
    off = angle_between(popped, q) > 1e-9
    # some 900 stretches at the lower share: known to 4 %
    assert off.double().mean().item() == pytest.approx(share, rel=0.12)
    # the first and the last frames are as likely to be off as all others
    short = noise.pops(q[:20].repeat(1, 100, 1), 0.5, share=share, generator=rng)
    ends = angle_between(short, q[:20].repeat(1, 100, 1)) > 1e-9
    for end in (ends[0], ends[-1]):
        assert end.double().mean().item() == pytest.approx(share, rel=0.25)
    moves = angle_between(popped[1:], popped[:-1]) > 1e-9
    if share < 0.1:  # hardly any stretch is cut off by another: most have a full length
        stays = _stretch_lengths(off, moves)
        inside = [length for length in stays if 5 <= length <= 15]
        assert len(inside) > 0.7 * len(stays)
        assert sum(inside) / len(inside) == pytest.approx(10.0, abs=0.5)


def _stretch_lengths(off, moves):
    """Numbers of frames that joints stay off at one place."""
    lengths = []
    for joint in range(off.shape[1]):
        count = 0
        for t in range(len(off)):
            if t > 0 and moves[t - 1, joint]:
                lengths, count = [*lengths, count] if count else lengths, 0
            count += bool(off[t, joint])
        lengths += [count] if count else []
    return lengths


def test_dropout_loses_stretches(rng):
    q = random_rotations(5000, 20, rng=rng)
    lost = ~validity(noise.dropout(q, share=0.2, length=(4, 8), generator=rng))
    assert lost.double().mean().item() == pytest.approx(0.2, rel=0.05)
    kept = noise.dropout(q, share=0.2, length=(4, 8), generator=rng)
    assert torch.equal(kept[validity(kept)], q[validity(kept)])
    starts = (lost[1:] & ~lost[:-1]).sum()
    assert 5.0 < lost.sum() / starts < 8.0  # the mean length is 6, some join
    assert validity(noise.dropout(q, share=0.0, generator=rng)).all()
    assert not validity(noise.dropout(q, share=1.0, generator=rng)).any()
    together = validity(noise.dropout(q, whole_frames=True, generator=rng))
    assert (together.all(-1) | ~together.any(-1)).all() and not together.all()


@pytest.mark.parametrize("axes", ["XYZ", "ZXY", "YZX"])
def test_quantised_angles_are_multiples_of_the_step(axes, rng, dtype):
    q, step = random_rotations(200, 3, rng=rng, dtype=dtype), 0.05
    angles = Rotation.from_quat(
        noise.quantise(q, step, axes=axes).double().reshape(-1, 4).numpy()
    ).as_euler(axes)
    # beyond a right angle there is another solution, beyond a half turn one of the other sign
    angles = angles[(abs(angles) < [3.1, 1.5, 3.1]).all(-1)]
    assert abs(angles / step - (angles / step).round()).max() < 1e-3
    assert angle_between(noise.quantise(q, step, axes=axes), q).max() < 1.5 * step


def test_quantised_rotation_vectors_are_multiples_of_the_step(rng):
    q = random_rotations(200, 3, rng=rng)
    coarse = noise.quantise(q, 0.1)
    small = so3.log(q).norm(dim=-1) < 2.9  # beyond half a turn the other vector is the shorter
    v = so3.log(coarse)[small] / 0.1
    assert (v - v.round()).abs().max() < 1e-9
    assert angle_between(coarse, q).max() < 0.1
    assert ((coarse * q).sum(-1) > 0).all(), "another hemisphere"


def test_flipped_signs(rng):
    q = smooth_motion(frames=4000, rng=rng)
    flipped = noise.flip_signs(q, share=0.3, generator=rng)
    assert_same_rotation(flipped, q)
    negative = (flipped * q).sum(-1) < 0
    assert negative.double().mean().item() == pytest.approx(0.3, rel=0.1)
    held = (noise.flip_signs(q, share=0.01, hold=True, generator=rng) * q).sum(-1) < 0
    changes = (held[1:] != held[:-1]).double().mean().item()
    assert changes == pytest.approx(0.01, rel=0.3)


@pytest.mark.parametrize(
    ("run", "error", "message"),
    [
        (lambda q: noise.correlated(q, 0.1, rho=1.0), ValueError, r"rho must be in \(-1, 1\), got"),
        (lambda q: noise.correlated(q, -0.1), ValueError, "sigma must be finite and >= 0, got"),
        (lambda q: noise.pops(q, 0.1, share=2.0), ValueError, r"share must be in \[0, 1\], got"),
        (lambda q: noise.pops(q, 0.1, length=(0, 3)), ValueError, "length must be >= 1, got 0"),
        (lambda q: noise.dropout(q, length=(5, 3)), ValueError, "length must be >= 5, got 3"),
        (lambda q: noise.dropout(q, length=(5, 9.5)), TypeError, "length must be an integer, got"),
        (lambda q: noise.gaussian(q, [0.1, 0.2, 0.3]), ValueError, "one for each of 2 joints, got"),
        (lambda q: noise.pops(q[:, :1], [0.1, 0.2]), ValueError, "one for each of 1 joints, got"),
        (lambda q: noise.flip_signs(q, share=-1.0), ValueError, r"share must be in \[0, 1\], got"),
        (lambda q: noise.quantise(q, 0.0), ValueError, "step must be finite and > 0, got 0.0"),
        (lambda q: noise.quantise(q, 0.1, axes="XXZ"), ValueError, "axes must be one of XYZ, XZY"),
        (lambda q: noise.quantise(q[0], 0.1), ValueError, "q must have shape"),
        (lambda q: noise.dropout(q.int()), TypeError, "q must be a floating-point tensor, got"),
    ],
)
def test_A23_B7_says_what_is_wrong(run, error, message, rng):
    with pytest.raises(error, match=message):
        run(random_rotations(4, 2, rng=rng))
