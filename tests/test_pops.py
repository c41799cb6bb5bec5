"""Displaced stretches: agreement with plain loops, and what is moved back."""

from itertools import accumulate

import pytest
import reference_pops as reference
import torch
from motions import angle_between, assert_same_rotation, numpy_of
from test_repair import WILD, displaced
from test_spectral import swaying

from torchquat import denoise, noise, repair, so3
from torchquat.filters._pops import undone


def wandering(frames, rng):
    """Steps of many sizes, and stretches of any length beside it, of joints ``(T, 2, 4)``."""
    size = 0.02 * 16 ** torch.rand(1, generator=rng, dtype=torch.float64)
    calm = torch.rand(frames, 2, 1, generator=rng, dtype=torch.float64).square()
    step = so3.exp(size * calm * torch.randn(frames, 2, 3, generator=rng, dtype=torch.float64))
    q = torch.stack(list(accumulate(step, so3.compose)))
    for joint in (0, 1, 1):
        begin, length = (int(torch.randint(n, (1,), generator=rng)) for n in (frames, 30))
        v = torch.randn(3, generator=rng, dtype=torch.float64)
        v = v / v.norm() * (0.25 + 0.9 * torch.rand(1, generator=rng, dtype=torch.float64))
        q = displaced(q, begin, begin + length, joint, v)
        again = begin + length + int(torch.randint(20, (1,), generator=rng))
        q = displaced(q, again, again + length, joint, v)
    return q


def all_present(q, sigma=0.0):
    """What becomes of joints without gaps, whose noise is known."""
    level = torch.full((1, q.shape[-2]), sigma, dtype=q.dtype)
    return undone(q, torch.ones(q.shape[:-1], dtype=torch.bool), level)


@pytest.mark.parametrize(
    ("longest", "here", "least"), [(90, 0.97, 20), (14, 0.7, 1)], ids=["clips", "shreds"]
)
def test_stretches_agree_with_plain_loops(longest, here, least, rng):
    moved = 0
    for _ in range(60):
        frames = int(torch.randint(3, longest, (1,), generator=rng))
        q, present = wandering(frames, rng), torch.rand(frames, 2, generator=rng) < here
        level = torch.tensor([[0.0, 0.03]], dtype=torch.float64)
        found = undone(q, present, level)
        for joint in range(2):
            known = numpy_of(q[:, joint]), present[:, joint].numpy()
            expected = reference.moved_back(*known, float(level[0, joint]))
            assert_same_rotation(found[:, joint], torch.from_numpy(expected), 1e-11)
            moved += not torch.equal(found[:, joint], q[:, joint])
    assert moved > least


@pytest.mark.parametrize(
    ("begin", "end", "speed", "jump", "is_moved"),
    [
        (60, 70, 0.0, 0.31, True),
        (60, 70, 0.0, 0.29, False),
        (60, 62, 0.0, 0.31, True),
        (1, 6, 0.0, 0.31, True),
        (60, 84, 0.0, 0.31, True),
        (60, 85, 0.0, 0.31, False),
        (60, 70, 0.1, -0.41, True),  # what jumps against the motion is a shorter step
        (60, 70, 0.1, -0.39, False),
        (60, 70, 0.1, 0.41, True),
        (60, 70, 0.1, 0.39, False),
        (105, 120, 0.0, 0.51, True),
        (105, 120, 0.0, 0.49, False),
        (104, 120, 0.0, 0.51, False),
        (0, 15, 0.0, 0.51, True),
        (0, 16, 0.0, 0.51, False),
    ],
)
def test_limits_of_stretches(begin, end, speed, jump, is_moved):
    turn = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    clean = so3.exp(speed * torch.arange(120.0)[:, None, None] * turn.expand(1, 2, 3))
    q = displaced(clean, begin, end, v=jump * turn)
    assert_same_rotation(all_present(q), clean if is_moved else q, 1e-9)


@pytest.mark.parametrize(("jump", "is_moved"), [(-0.41, True), (-0.39, False)])
def test_a_stretch_that_jumps_against_the_motion_at_both_ends(jump, is_moved):
    """Its steps are the shortest that a jump may have; the motion turns back in its middle."""
    turn = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    angle = -0.1 * (torch.arange(120.0).double()[:, None, None] - 64.5).abs()
    clean = so3.exp(angle * turn.expand(1, 2, 3))
    q = displaced(clean, 60, 70, v=jump * turn)
    assert_same_rotation(all_present(q), clean if is_moved else q, 1e-9)


@pytest.mark.parametrize(("sigma", "is_moved"), [(0.077, True), (0.078, False)])
def test_jumps_that_noise_may_have_made_stay(sigma, is_moved):
    """Of 0.9 rad, below three root mean squares of an excess: sqrt(15) of the noise each."""
    clean = so3.exp(torch.zeros(120, 2, 3, dtype=torch.float64))
    q = displaced(clean, 60, 70, v=0.9 * torch.tensor([1.0, 0.0, 0.0]))
    found = all_present(q, sigma)
    assert_same_rotation(found, clean if is_moved else q, 1e-9)
    assert_same_rotation(repair(q, sigma=sigma)[0], found, 1e-9)


def test_stretches_that_come_again():
    clean = q = swaying()
    for begin in (60, 80, 100, 115):
        q = displaced(q, begin, begin + 10)
    assert angle_between(repair(q)[0], clean).max() < 0.01


@pytest.mark.parametrize(
    ("begin", "end"), [(60, 65), (60, 75), (0, 5), (0, 12), (188, 200), (195, 200), (150, 165)]
)
def test_stretches_are_moved_back(begin, end):
    clean = swaying()
    result, trust = repair(displaced(clean, begin, end))
    assert (trust == 1).all()
    assert angle_between(result, clean).max() < 0.01


def test_stretches_that_cut_each_other_off(rng):
    clean = swaying()
    q = displaced(displaced(clean, 90, 98), 98, 110, v=-0.7 * WILD.roll(1))
    assert angle_between(repair(q)[0], clean).max() < 0.02


def test_stretches_in_noise(rng):
    clean = swaying()
    noisy = noise.gaussian(displaced(clean, 80, 92), 0.01, generator=rng)
    assert angle_between(denoise(noisy), clean).max() < 0.06
