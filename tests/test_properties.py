"""Random shapes, strides, dtypes, weights, boundaries and radii, by hypothesis."""

import numpy as np
import reference
import reference_nonlocal
import torch
from filters_under_test import ALL, APART
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motions import assert_same_rotation, numpy_of, smooth_motion, special_orthogonal

from torchquat import bilateral_filter, gaussian_filter, linear_filter, nonlocal_pose_means
from torchquat.timeline import BOUNDARIES

SETTINGS = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
QUICK = sorted({"gaussian", "bilateral", "nonlocal-joint", "median-truncate", "lifting-haar"})
ANY = sorted(name for name in ALL if "per-joint" not in name)
"""Filters of any number of joints."""
LAYOUTS = ("plain", "components first", "joints first", "every second", "flipped signs", "scaled")


@st.composite
def motions(draw, *, batch=(0, 2), frames=(1, 14), joints=(1, 3)):
    """A motion in any memory layout, ``(..., T, J, 4)``, with any weights."""
    rng = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    lead = draw(st.lists(st.integers(1, 3), min_size=batch[0], max_size=batch[1]))
    size = draw(st.integers(*frames)), draw(st.integers(*joints))
    q = smooth_motion(*lead, frames=size[0], joints=size[1], step=0.4, rng=rng)
    q = laid_out(q, draw(st.sampled_from(LAYOUTS)), rng)
    kind = draw(st.sampled_from(("none", "ones", "random", "gaps", "one joint")))
    weight = None
    if kind != "none":
        weight = torch.rand(q.shape[:-1], generator=rng, dtype=q.dtype) + 0.05
    if kind == "ones":
        weight = torch.ones_like(weight)
    if kind == "gaps":
        weight = weight * (torch.rand(weight.shape, generator=rng) > 0.4)
    if kind == "one joint":
        weight = weight[..., :1]
    return q, weight, rng


def laid_out(q, layout, rng):
    """The same rotations somewhere else in memory, or written otherwise."""
    if layout == "components first":
        return q.movedim(-1, 0).contiguous().movedim(0, -1)
    if layout == "joints first":
        return q.transpose(-2, -3).contiguous().transpose(-2, -3)
    if layout == "every second":
        return torch.stack([q, torch.full_like(q, torch.nan)], -2).flatten(-3, -2)[..., ::2, :]
    if layout == "flipped signs":
        return q * torch.where(torch.rand(q.shape[:-1], generator=rng) < 0.5, -1.0, 1.0)[..., None]
    if layout == "scaled":
        return q * (0.1 + 5.0 * torch.rand(q.shape[:-1], generator=rng).double())[..., None]
    return q


def by_the_oracle(function, q, weight, **options):
    """Of every batch item alone."""
    weight = torch.ones(q.shape[:-1], dtype=q.dtype) if weight is None else weight
    items = q.reshape(-1, *q.shape[-3:])
    trusts = weight.expand(q.shape[:-1]).reshape(items.shape[:-1])
    made = [
        function(numpy_of(item), numpy_of(trust), **options)
        for item, trust in zip(items, trusts, strict=True)
    ]
    return torch.as_tensor(np.stack(made)).reshape(q.shape)


windows = st.fixed_dictionaries(
    {
        "radius": st.integers(0, 6),
        "boundary": st.sampled_from(BOUNDARIES),
        "causal": st.booleans(),
        "sigma_t": st.floats(0.3, 4.0),
    }
)


@SETTINGS
@given(motions(), windows)
def test_gaussian_agrees_with_loops(motion, window):
    q, weight, _ = motion
    expected = by_the_oracle(
        lambda x, w: reference.every_joint(reference.gaussian_filter, x, w, **window), q, weight
    )
    assert_same_rotation(gaussian_filter(q, weight, **window), expected, 1e-9)


@SETTINGS
@given(
    motions(batch=(0, 1), frames=(1, 10)),
    windows,
    st.floats(0.05, 2.0),
    st.sampled_from(("gaussian", "exponential")),
    st.integers(1, 2),
)
def test_bilateral_agrees_with_loops(motion, window, sigma_g, kernel, iterations):
    q, weight, _ = motion
    options = {**window, "sigma_g": sigma_g, "kernel": kernel, "iterations": iterations}
    expected = by_the_oracle(
        lambda x, w: reference.every_joint(reference.bilateral_filter, x, w, **options), q, weight
    )
    assert_same_rotation(bilateral_filter(q, weight, **options), expected, 1e-9)


@SETTINGS
@given(
    motions(batch=(0, 1), frames=(1, 8), joints=(1, 2)),
    st.integers(0, 2),
    st.integers(0, 3),
    st.sampled_from(BOUNDARIES),
    st.booleans(),
    st.floats(0.1, 1.0),
)
def test_nonlocal_means_agree_with_loops(motion, patch, search, boundary, causal, sigma):
    q, weight, _ = motion
    options = {
        "sigma": sigma,
        "patch_radius": patch,
        "search_radius": search,
        "boundary": boundary,
        "causal": causal,
    }
    expected = by_the_oracle(
        reference_nonlocal.nonlocal_pose_means, q, weight, groups=[0] * q.shape[-2], **options
    )
    assert_same_rotation(nonlocal_pose_means(q, weight, groups="pose", **options), expected, 1e-9)


@SETTINGS
@given(motions(), st.lists(st.floats(-1.0, 1.0), min_size=0, max_size=3), st.booleans())
def test_any_symmetric_mask_agrees_with_loops(motion, side, causal):
    q, weight, _ = motion
    mask = [*side[::-1], 3.5, *side]  # a sum that is not near 0
    if causal:
        mask = [*mask[: len(side) + 1], *[0.0] * len(side)]
    expected = by_the_oracle(
        lambda x, w: reference.every_joint(
            reference.linear_filter, x, w, mask=mask, causal=causal and bool(side)
        ),
        q,
        weight,
    )
    given_mask = torch.tensor(mask, dtype=torch.float64)
    found = linear_filter(q, weight, mask=given_mask, causal=causal and bool(side))
    assert_same_rotation(found, expected, 1e-9)


@SETTINGS
@given(motions(), st.sampled_from(ANY), st.data())
def test_weight_0_equals_absent(motion, name, data):
    """What a frame without weight holds makes no difference: numbers, NaN or nothing.

    Where a joint has no frame at all, each keeps what it holds.
    """
    q, weight, _ = motion
    weight = torch.ones(q.shape[:-1], dtype=q.dtype) if weight is None else weight
    weight = weight.expand(q.shape[:-1]).clone()
    frame = data.draw(st.integers(0, q.shape[-3] - 1))
    weight[..., frame, :] = 0.0
    other = q.clone()
    other[..., frame, :, :] = data.draw(st.sampled_from((torch.nan, torch.inf, 0.0)))
    seen = (weight > 0).any(-2, keepdim=True).expand(weight.shape)
    found, expected = ALL[name](other, weight), ALL[name](q, weight)
    assert_same_rotation(found[seen], expected[seen], 1e-9)


@SETTINGS
@given(motions(frames=(2, 14)), st.sampled_from(QUICK))
def test_equivariance(motion, name):
    """Turns of the world and of the body come out as they went in."""
    q, weight, rng = motion
    turn = special_orthogonal(rng)
    assert_same_rotation(ALL[name](q @ turn, weight), ALL[name](q, weight) @ turn, 1e-8)


@SETTINGS
@given(motions(batch=(1, 2)), st.sampled_from(ANY))
def test_a_batch_of_N_is_N_batches(motion, name):
    q, weight, _ = motion
    together = ALL[name](q, weight)
    for index in range(len(q)):
        trust = None if weight is None else weight.expand(q.shape[:-1])[index]
        assert_same_rotation(ALL[name](q[index], trust), together[index], 1e-9)


@SETTINGS
@given(motions(joints=(3, 3)), st.sampled_from(sorted(set(ANY) & set(APART))))
def test_joints_are_alone(motion, name):
    q, weight, _ = motion
    order = torch.tensor([2, 0, 1])
    trust = None if weight is None else weight.expand(q.shape[:-1])[..., order]
    assert_same_rotation(
        ALL[name](q[..., order, :], trust), ALL[name](q, weight)[..., order, :], 1e-9
    )


@SETTINGS
@given(motions(), st.sampled_from(ANY), st.sampled_from((torch.float32, torch.float16)))
def test_dtypes_and_shapes_come_back(motion, name, dtype):
    q, weight, _ = motion
    weight = None if weight is None else weight.to(dtype)
    result = ALL[name](q.to(dtype), weight)
    assert result.dtype == dtype and result.shape == q.shape
    assert result.isfinite().all()
    assert ((result.double().norm(dim=-1) - 1).abs() < 2e-3).all()
