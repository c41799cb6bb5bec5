"""Compression and salience of details, spelled out number by number."""

import numpy as np
import pytest
import torch
from motions import smooth_motion

from torchquat import LiftingTransform, compress, salience, stored_share
from torchquat.filters.lifting import Pyramid


def split(batch, frames, levels, rng):
    q = smooth_motion(*batch, frames=frames, step=0.4, rng=rng)
    return LiftingTransform("linear", levels=levels)(q)


def lengths(detail):
    return np.linalg.norm(detail.numpy(), axis=-1)


@pytest.mark.parametrize("keep", [0.0, 0.25, 0.5, 0.95, 1.0])
def test_compression_keeps_its_share_of_equal_details(keep):
    """Of a steady swing all details of a level are alike."""
    detail = torch.ones(20, 1, 3, dtype=torch.float64)
    pyramid = Pyramid(torch.zeros(20, 1, 4, dtype=torch.float64), (detail,))
    kept = (compress(pyramid, keep).details[0] != 0).all(-1)
    assert int(kept.sum()) == round(20 * keep)


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
@pytest.mark.parametrize("keep", [0.0, 0.1, 0.5, 1.0])
def test_compression_keeps_the_largest_by_the_frames_they_move(batch, keep, rng):
    """A detail of a level moves twice as many frames as one of the next finer level."""
    pyramid = split(batch, 21, 3, rng)
    found = compress(pyramid, keep)
    assert torch.equal(found.approx, pyramid.approx)
    for item in np.ndindex(*batch):
        rated = [
            lengths(detail[item]) * np.sqrt(2.0 ** (3 - level))
            for level, detail in enumerate(pyramid.details)
        ]
        everything = np.sort(np.concatenate([each.ravel() for each in rated]))[::-1]
        kept = everything[: round(keep * len(everything))]
        limit = kept[-1] if len(kept) else np.inf
        stored = pyramid.approx[item][..., 0].numel()
        for detail, whole, size in zip(found.details, pyramid.details, rated, strict=True):
            large = torch.from_numpy(size >= limit)[..., None]
            assert torch.equal(detail[item], torch.where(large, whole[item], 0.0))
            stored += int(large.sum())
        assert stored_share(found)[item] == pytest.approx(stored / (21 * 3))


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_without_details_everything_is_stored(batch, rng):
    assert torch.equal(stored_share(split(batch, 21, 0, rng)), torch.ones(batch).double())


@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize(("frames", "levels"), [(21, 3), (32, 3), (21, 1), (21, 0)])
def test_salience_is_the_mean_over_levels_of_shares_of_the_median(batch, frames, levels, rng):
    pyramid = split(batch, frames, levels, rng)
    found = salience(pyramid)
    assert found.shape == (*batch, frames, 3)
    for item in np.ndindex(*batch):
        expected = np.zeros((frames, 3))
        for level, detail in enumerate(pyramid.details):
            size = lengths(detail[item])
            share = size / np.median(size, axis=0)
            for t in range(frames):
                place = t // 2 ** (levels - level)
                expected[t] += share[place] if place < len(share) else 0.0
        assert np.allclose(found[item].numpy(), expected / max(levels, 1), rtol=1e-10)


def test_nothing_is_salient_where_nothing_moves():
    q = torch.tensor([0.0, 0.0, 0.0, 1.0]).double().expand(16, 2, 4)
    assert (salience(LiftingTransform("haar", levels=2)(q)) == 0).all()


def test_a_moment_of_motion_stands_out_of_rest(rng):
    """Most details are 0: the others are measured by each other."""
    q = torch.tensor([0.0, 0.0, 0.0, 1.0]).double().repeat(32, 1, 1)
    q[10:16] = smooth_motion(frames=6, joints=1, rng=rng)
    found = salience(LiftingTransform("haar", levels=1)(q))[:, 0]
    assert 0.5 < float(found[10:16].mean()) < 2.0 and found[:10].max() == found[18:].max() == 0.0
