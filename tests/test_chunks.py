"""Long sequences in pieces."""

import pytest
import torch
from filters_under_test import ALL
from motions import smooth_motion

from torchquat import (
    AutoDenoiser,
    BilateralFilter,
    GaussianFilter,
    HampelFilter,
    OneEuroFilter,
    in_chunks,
    noise,
)
from torchquat.chunks import window_of

NEEDS_MORE = (
    "auto",
    "hampel",
    "kalman",
    "kernel-pca",
    "lifting",
    "local-spectrum",
    "low-rank",
    "nonlocal-embedding",
    "one-euro",
    "bilateral-circular",
    "principal",
    "repair",
)
WINDOWED = [name for name in ALL if not name.startswith(NEEDS_MORE)]


@pytest.fixture
def shaky(rng):
    return noise.gaussian(smooth_motion(2, frames=150, rng=rng), 0.05, generator=rng)


def gaps(rng):
    """Single missing frames, long gaps, some to the end or from the start, a joint never seen."""
    weight = torch.rand(2, 150, 3, generator=rng, dtype=torch.float64)
    weight[torch.rand(2, 150, 3, generator=rng) < 0.2] = 0.0
    weight[:, 30:75, 1] = 0.0
    weight[0, :40, 0] = 0.0
    weight[1, 110:, 2] = 0.0
    weight[1, :, 0] = 0.0
    return weight


@pytest.mark.parametrize("name", WINDOWED)
@pytest.mark.parametrize("frames", [9, 64, 149, 1000])
def test_pieces_are_bitwise_the_whole(name, frames, shaky, rng):
    run = ALL[name]
    shaky[0, 90:93] = torch.nan
    for weight in (None, gaps(rng)):
        assert torch.equal(in_chunks(run, shaky, weight, frames=frames), run(shaky, weight))


@pytest.mark.parametrize("name", [name for name in ALL if name not in WINDOWED])
def test_filters_that_need_more_are_refused(name, shaky):
    with pytest.raises((TypeError, ValueError), match=r"filter must see|boundary must|embedding"):
        in_chunks(ALL[name], shaky)


def test_no_pass_at_all_fills_gaps_across_pieces(shaky, rng):
    run, weight = BilateralFilter(iterations=0), gaps(rng)
    assert torch.equal(in_chunks(run, shaky, weight, frames=9), run(shaky, weight))


def test_B1_nothing_and_one_frame():
    run = GaussianFilter(1.0)
    for frames in (0, 1):
        q = torch.tensor([0.0, 0.0, 0.0, 2.0]).expand(frames, 2, 4)
        assert torch.equal(in_chunks(run, q, frames=1), run(q))


def test_a_piece_reads_no_more_than_it_needs(shaky):
    seen = []

    class Spy(GaussianFilter):
        def forward(self, q, weight=None):
            seen.append(q.shape[-3])
            return super().forward(q, weight)

    from torchquat._online import rules

    rules._PLANS[Spy] = rules._PLANS[GaussianFilter]
    try:
        in_chunks(Spy(1.0, radius=3), shaky, frames=50)
    finally:
        del rules._PLANS[Spy]
    assert seen == [53, 56, 53]


def test_what_a_filter_reads():
    assert window_of(GaussianFilter(1.0, causal=True)) == (3, 0, 1)
    for run, why in (
        (AutoDenoiser(), "whole sequence"),
        (OneEuroFilter(0.1, 0.1), "carries an estimate"),
        (HampelFilter(2), "however far"),
    ):
        with pytest.raises(TypeError, match=why):
            window_of(run)


def test_pieces_must_have_frames(shaky):
    with pytest.raises(ValueError, match="frames must be"):
        in_chunks(GaussianFilter(1.0), shaky, frames=0)
