"""Repair: agreement with plain loops; what is found, what is left alone, what it is worth."""

import numpy as np
import pytest
import reference_repair as reference
import torch
from motions import angle_between, assert_same_rotation, numpy_of, random_rotations, smooth_motion
from test_spectral import swaying
from torch.autograd import gradcheck

from torchquat import OutlierRepair, denoise, fill_missing, noise, repair, so3
from torchquat.filters import _kriging
from torchquat.filters._kriging import LEVELS, around, predict
from torchquat.filters._outliers import find_outliers
from torchquat.filters.repair import _filled

LIMITS = [
    (0.32, None, True),  # 0.9 of 0.35 rad, below which what was flagged comes back
    (0.31, None, False),
    (1.00, 0.1, True),
    (0.90, 0.1, False),  # noise may go so far
]
WILD = torch.tensor([0.4, -0.5, 0.6], dtype=torch.float64)


def displaced(q, begin, end, joint=1, v=WILD):
    away = torch.zeros_like(q[..., :3])
    away[begin:end, joint] = v
    return so3.turn(q, away)


def gesture(peak=0.8, frames=120, width=3.0):
    """Stillness, a very fast turn of 2 rad about one axis, stillness; all joints alike."""
    t = torch.arange(frames, dtype=torch.float64) - frames / 2
    v = torch.sigmoid(t / width)[:, None, None] * torch.tensor([peak, 0.0, -1.8])
    return so3.exp(v.expand(-1, 3, -1) + 0.01 * torch.sin(0.2 * t)[:, None, None])


@pytest.mark.parametrize("level", range(len(LEVELS)))
def test_predictions_agree_with_plain_loops(level, rng):
    q = smooth_motion(frames=14, joints=2, rng=rng)
    good = torch.rand(14, 2, generator=rng) < 0.7
    rows = torch.stack([plane.mT for plane in q.unbind(-1)])
    found = predict(around(rows, good.mT), torch.full((2, 1), level))
    for joint in range(2):
        expected, variance = reference.predicted(
            numpy_of(q[:, joint]), good[:, joint].numpy(), LEVELS[level]
        )
        actual = so3.normalize(found.q[:, joint].mT)
        assert_same_rotation(actual, torch.from_numpy(expected), 1e-7)
        assert np.allclose(found.variance[joint], variance, rtol=1e-6)


def test_tables_are_solved_anew_to_the_same():
    """What is compared with loops above was made when the package was loaded."""
    weights, variances = _kriging._solved()
    for made, kept in ((weights, _kriging._WEIGHTS), (variances, _kriging._VARIANCES)):
        assert torch.equal(torch.from_numpy(made), kept)


@pytest.mark.parametrize(
    ("sigma", "share"), [(0.0, 0.12), (0.05, 0.12), (0.0, 0.35), (0.02, 0.25), (0.0, 0.5)]
)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_flags_agree_with_plain_loops(sigma, share, seed):
    rng = torch.Generator().manual_seed(seed)
    clean = swaying(frames=40, joints=4)
    q = noise.gaussian(noise.impulse(clean, 0.5, share=share, generator=rng), sigma, generator=rng)
    q = noise.flip_signs(q, generator=rng)
    present = torch.rand(40, 4, generator=rng) < 0.95
    found = find_outliers(q, present, torch.tensor(sigma))
    for joint in range(4):
        good, level = reference.good_samples(
            numpy_of(q[:, joint]), present[:, joint].numpy(), sigma
        )
        assert found.level[0, joint] == level
        assert np.array_equal(found.good[:, joint].numpy(), good)
    assert 3 < (present & ~found.good).sum() < 100


@pytest.mark.parametrize(("jump", "sigma", "is_wild"), LIMITS)
def test_limits_of_wild_samples(jump, sigma, is_wild):
    turn = torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64)
    q = displaced(so3.exp(torch.zeros(90, 2, 3, dtype=torch.float64)), 40, 41, v=jump * turn)
    _, trust = repair(q, sigma=sigma)
    assert (trust == 0).nonzero().tolist() == ([[40, 1]] if is_wild else [])


@pytest.mark.parametrize(
    ("gone", "predicted"),
    [
        ([0], [0]),
        ([29], [29]),
        ([0, 1, 2], [2]),  # nothing near one side of the others
        ([27, 28, 29], [27]),
        ([10, 11, 12, 13, 14], [10, 11, 12, 13, 14]),
        (list(range(10, 19)), [10, 18]),
    ],
)
def test_what_is_filled_lies_near_a_side_or_between(gone, predicted, rng):
    q = smooth_motion(frames=30, joints=1, rng=rng)
    good = torch.ones(30, 1, dtype=torch.bool)
    good[gone] = False
    found = _filled(q, good, torch.tensor([[1]]))[:, 0]
    expected, _ = reference.predicted(numpy_of(q[:, 0]), good[:, 0].numpy(), LEVELS[1])
    between = fill_missing(q, good.double())[:, 0]
    for t in gone:
        wanted = torch.from_numpy(expected[t]) if t in predicted else between[t]
        assert_same_rotation(found[t], wanted, 1e-7)
    assert torch.equal(found[good[:, 0]], q[good])


@pytest.mark.parametrize("places", [[50], [1], [70, 71], [30, 33, 90]])
def test_wild_samples_are_found_and_replaced(places):
    clean = swaying()
    q = clean.clone()
    for place in places:
        q = displaced(q, place, place + 1, v=(1 - 2 * (place % 2)) * WILD)
    result, trust = repair(q)
    assert (trust[:, 1] == 0).nonzero()[:, 0].tolist() == places
    assert (trust[:, [0, 2]] == 1).all()
    assert angle_between(result, clean).max() < 0.02
    kept = trust == 1
    assert angle_between(result, q)[kept].max() < 1e-12


@pytest.mark.parametrize("places", [[0], [199], [0, 50], [70, 199]])
def test_wild_samples_at_the_ends_are_put_right(places):
    clean = swaying()
    q = clean.clone()
    for place in places:
        q = displaced(q, place, place + 1)
    assert angle_between(repair(q)[0], clean).max() < 0.02


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_many_wild_samples(share, rng):
    clean = swaying()
    result = denoise(noise.impulse(clean, 0.5, share=share, generator=rng))
    assert angle_between(result, clean).square().mean().sqrt() < 0.01


def test_lasting_changes_and_fast_gestures_stay():
    for clean in (gesture(), gesture(width=1.0), gesture(width=0.5), displaced(swaying(), 60, 200)):
        result, trust = repair(clean)
        assert (trust == 1).all()
        assert_same_rotation(result, clean)


def test_motion_of_all_kinds_stays(rng):
    for q in (swaying(), smooth_motion(frames=200, rng=rng), noise.gaussian(swaying(), 0.1)):
        assert_same_rotation(OutlierRepair()(q), q)


def test_heavy_noise_is_noise(rng):
    noisy = noise.gaussian(swaying(), 0.5, generator=rng)
    assert (repair(noisy, sigma=0.5)[1] == 1).all()


def test_signs_make_no_difference(rng):
    q = displaced(noise.impulse(swaying(), 0.5, generator=rng), 100, 110)
    for hold in (False, True):
        flipped = noise.flip_signs(q, hold=hold, generator=rng)
        assert torch.equal(repair(flipped)[1], repair(q)[1])
        assert_same_rotation(repair(flipped)[0], repair(q)[0])


def test_missing_frames_are_filled_and_stay_without_weight(rng):
    clean = swaying()
    q = displaced(clean, 50, 51)
    weight = 0.5 + torch.rand(200, 3, generator=rng, dtype=torch.float64)
    weight[60:64] = 0.0
    q[100:103, 2] = torch.nan
    q[61] = so3.turn(clean[61], WILD)
    result, trust = repair(q, weight)
    gone = weight == 0.0
    gone[100:103, 2] = gone[50, 1] = True
    assert torch.equal(trust, torch.where(gone, 0.0, weight))
    assert angle_between(result, clean).max() < 0.01


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16, torch.float32])
def test_B9_confidences_have_the_dtype_of_the_rotations(kind):
    result, trust = repair(swaying().to(kind))
    assert result.dtype == trust.dtype == kind


def test_missing_frames_are_predicted_as_the_oracle_does(rng):
    """By the level of noise that the joint has; nothing of what lay there counts."""
    q = noise.gaussian(swaying(frames=40), 0.05, generator=rng)
    present = torch.rand(40, 3, generator=rng) < 0.9
    result, trust = repair(q, present.double())
    for joint in range(3):
        known = numpy_of(q[:, joint]), present[:, joint].numpy()
        good, level = reference.good_samples(*known)
        expected, _ = reference.predicted(known[0], good, LEVELS[level])
        wanted = torch.where(trust[:, [joint]] > 0, q[:, joint], torch.from_numpy(expected))
        inside = slice(1, -1)  # where there are neighbours to both sides
        assert_same_rotation(result[inside, joint], wanted[inside], 1e-7)


@pytest.mark.parametrize("sigma", [0.02, [0.01, 0.02, 0.03], torch.tensor(0.02)])
def test_B11_known_noise_goes_where_the_motion_is(sigma, rng):
    q = smooth_motion(frames=40, rng=rng)
    q[9, 1] = so3.turn(q[9, 1], WILD)
    expected = repair(q, sigma=sigma)
    with torch.device("meta"):
        found = repair(q, sigma=sigma)
    assert all(torch.equal(x, y) for x, y in zip(found, expected, strict=True))
    assert not torch.equal(expected[0][9, 1], q[9, 1])


def test_alone_and_in_a_batch_to_the_same_bits(rng):
    clean = swaying()
    impulses, pops = (
        make(clean, 0.5, generator=rng).float() for make in (noise.impulse, noise.pops)
    )
    together, trust = repair(torch.stack([impulses, clean.float(), pops]))
    for item, q in enumerate((impulses, clean.float(), pops)):
        alone = repair(q)
        assert torch.equal(together[item], alone[0]) and torch.equal(trust[item], alone[1])
        for joint in range(3):
            assert torch.equal(repair(q[:, [joint]])[0], alone[0][:, [joint]])


@pytest.mark.parametrize("sigma", [-0.1, float("nan"), float("inf"), [0.1, -0.1]])
def test_A23_noise_out_of_range(sigma, rng):
    with pytest.raises(ValueError, match="sigma must be finite and >= 0, got"):
        repair(smooth_motion(frames=8, joints=2, rng=rng), sigma=sigma)


def test_A23_noise_of_other_joints(rng):
    with pytest.raises(ValueError, match="one for each of 2 joints, got"):
        repair(smooth_motion(frames=8, joints=2, rng=rng), sigma=torch.tensor([0.1, 0.1, 0.1]))


def test_gradients_flow_to_what_is_kept(rng):
    q = displaced(displaced(swaying(frames=48), 10, 11), 25, 32).requires_grad_()
    result, trust = repair(q)
    (slope,) = torch.autograd.grad((result * torch.rand(q.shape, generator=rng)).sum(), q)
    assert slope.isfinite().all()
    assert (slope[10, 1] == 0).all() and trust[10, 1] == 0
    assert (slope.abs().sum(-1) > 0).sum() == 3 * 48 - 1

    def fixed(q):
        """Displacements are taken as given: only frames beside the stretch vary."""
        whole = torch.cat([q, start[20:]], 0)
        return repair(whole)[0][:20]

    start = q.detach()
    assert gradcheck(
        fixed, (start[:20].clone().requires_grad_(),), eps=1e-6, atol=1e-5, fast_mode=True
    )


@pytest.mark.parametrize("frames", [0, 1, 2, 3, 5])
def test_short_sequences(frames, rng):
    q = smooth_motion(frames=frames, rng=rng) if frames else torch.zeros(0, 3, 4)
    result, trust = repair(q)
    assert_same_rotation(result, q)
    assert trust.shape == (frames, 3) and (trust == 1).all()
    wide = random_rotations(frames, 3, rng=rng)  # each a jump, and none that leads back
    assert_same_rotation(repair(wide[:2])[0], wide[:2])
    assert repair(torch.zeros(4, 0, 4))[0].shape == (4, 0, 4)
