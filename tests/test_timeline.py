"""What lies outside a sequence, spelled out frame by frame."""

import pytest
import torch
from motions import IDENTITY, assert_same_rotation, random_rotations, smooth_motion

from torchquat import so3, timeline
from torchquat.timeline import BOUNDARIES

PICTURES = {
    "replicate": ("aaa", "ddd"),
    "reflect": ("dcb", "cba"),
    "circular": ("bcd", "abc"),
}


def padded(q, boundary, radius, weight=None):
    trust = torch.ones_like(q[..., 0]) if weight is None else weight
    return timeline.pad(q, trust, radius, boundary)


@pytest.mark.parametrize("boundary", PICTURES)
def test_pictures(boundary, rng):
    q = random_rotations(4, 2, rng=rng)
    before, after = PICTURES[boundary]
    wanted = q[["abcd".index(letter) for letter in before + "abcd" + after]]
    actual, trust = padded(q, boundary, 3)
    assert torch.equal(actual, wanted) and torch.equal(trust, torch.ones(10, 2).double())


@pytest.mark.parametrize(
    ("boundary", "picture"),
    [
        ("replicate", "aaaaaa abc cccccc"),
        ("reflect", "cbabcb abc babcba"),
        ("circular", "abcabc abc abcabc"),
    ],
)
def test_pictures_of_windows_longer_than_the_sequence(boundary, picture, rng):
    q = random_rotations(3, 1, rng=rng)
    wanted = q[["abc".index(letter) for letter in picture.replace(" ", "")]]
    assert torch.equal(padded(q, boundary, 6)[0], wanted)


def test_truncate_weighs_nothing_outside(rng):
    q = random_rotations(4, 2, rng=rng)
    _, trust = padded(q, "truncate", 3)
    assert trust[:, 0].tolist() == [0, 0, 0, 1, 1, 1, 1, 0, 0, 0]


def test_extrapolate_goes_on_with_the_increment_at_the_edge(rng):
    q = smooth_motion(frames=4, rng=rng, step=0.4)
    actual, _ = padded(q, "extrapolate", 3)
    for edge, inner, outward in ((3, 4, -1), (6, 5, 1)):
        turn = so3.relative(actual[inner], actual[edge])
        for step in (1, 2, 3):
            place = actual[edge + outward * (step - 1)]
            assert_same_rotation(actual[edge + outward * step], so3.compose(place, turn))


@pytest.mark.parametrize("boundary", ["replicate", "reflect", "circular", "extrapolate"])
def test_a_frame_outside_weighs_as_much_as_the_frame_it_stands_for(boundary, rng):
    weight = torch.tensor([0.1, 0.2, 0.0, 0.4]).double()[:, None]
    before, after = PICTURES.get(boundary, ("aaa", "ddd"))
    wanted = weight[["abcd".index(letter) for letter in before + "abcd" + after]]
    assert torch.equal(padded(random_rotations(4, 1, rng=rng), boundary, 3, weight)[1], wanted)


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("radius", [0, 1, 5])
def test_B1_B2_one_frame_and_none(boundary, radius, rng):
    q = random_rotations(1, 2, rng=rng)
    actual, trust = padded(q, boundary, radius)
    assert_same_rotation(actual, q.expand(1 + 2 * radius, 2, 4))
    expected = 1.0 if boundary == "truncate" else 1.0 + 2 * radius
    assert trust[:, 0].sum() == expected
    nothing, trust = padded(q[:0], boundary, radius)
    assert torch.equal(nothing, IDENTITY.expand(2 * radius, 2, 4)) and not trust.any()


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_causal_windows_replicate_or_truncate(boundary):
    expected = "replicate" if boundary == "replicate" else "truncate"
    assert timeline.past_boundary(boundary, causal=True) == expected
    assert timeline.past_boundary(boundary, causal=False) == boundary


def test_prepare_gives_unit_quaternions_in_the_hemisphere_of_the_input(rng):
    q = -3.0 * random_rotations(5, 2, rng=rng)
    q[2, 0] = torch.nan
    unit, trust = timeline.prepare(q)
    assert torch.allclose(unit.norm(dim=-1), torch.ones(5, 2).double())
    assert ((unit * q.nan_to_num(0.0)).sum(-1) >= 0).all()
    assert trust.tolist() == [[1, 1], [1, 1], [0, 1], [1, 1], [1, 1]]


def test_a_missing_frame_has_the_sign_of_what_it_is_filled_from():
    q = torch.full((3, 1, 4), -0.5, dtype=torch.float64)
    q[1] = torch.nan
    assert torch.equal(timeline.prepare(q)[0], torch.full_like(q, -0.5))


def test_restore_gives_back_hemisphere_and_dtype():
    q = torch.stack([IDENTITY, -IDENTITY])[:, None].half()
    result = timeline.restore(IDENTITY.expand(2, 1, 4), q.double(), q)
    assert torch.equal(result, q)


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("frames", [0, 1, 4])
def test_B11_padding_goes_where_the_signal_is(boundary, frames, rng):
    q = random_rotations(frames, 2, rng=rng) if frames else torch.zeros(0, 2, 4).double()
    for trust in (None, torch.rand(frames, 2, generator=rng).double()):
        expected = timeline.pad(q, trust, 2, boundary)
        with torch.device("meta"):
            found = timeline.pad(q, trust, 2, boundary)
        assert torch.equal(found[0], expected[0])
        if trust is None and boundary != "truncate" and frames:
            assert found[1] is None and expected[1] is None
        else:
            assert torch.equal(found[1], expected[1])
            assert found[1].dtype == q.dtype


@pytest.mark.parametrize("frames", [1, 2, 7, 8])
@pytest.mark.parametrize("compiling", [False, True])
def test_frames_taken_apart_and_put_together(frames, compiling, rng, monkeypatch):
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: compiling)
    q = random_rotations(2, frames, 3, rng=rng)
    even, odd = timeline.halves(q)
    assert torch.equal(even, q[:, ::2]) and torch.equal(odd, q[:, 1::2])
    assert torch.equal(timeline.interleave(even, odd), q)
    assert torch.equal(timeline.first_frames(q, frames - 1), q[:, : frames - 1])
