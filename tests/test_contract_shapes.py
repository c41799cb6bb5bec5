"""Odd shapes, types and modes, part B of the contract."""

import copy
import io as memory

import numpy as np
import pytest
import torch
from filters_under_test import ALL, every_filter
from motions import BOUND, IDENTITY, assert_same_rotation, random_rotations, smooth_motion

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    LinearFilter,
    _blocks,
    fill_missing,
    lifting_denoiser,
    validity,
)


@pytest.mark.parametrize(
    ("shape", "kind"),
    [((0, 3), torch.bfloat16), ((0, 5, 3), torch.float64), ((2, 0, 3), torch.float32)],
)
def test_B1_nothing_in_nothing_out(shape, kind, run):
    result = run(torch.zeros(*shape, 4, dtype=kind))
    assert result.shape == (*shape, 4) and result.dtype == kind


@every_filter("B1")
def test_B1_no_joints(run):
    assert run(torch.zeros(5, 0, 4)).shape == (5, 0, 4)


def test_B15_values_for_another_number_of_joints(rng):
    q = random_rotations(5, 2, rng=rng)
    for run, message in (
        (BilateralFilter([1.0, 2.0, 3.0]), r"sigma_t must be one value or one per joint \(2\)"),
        (BilateralFilter(1.0, [1.0, 2.0, 3.0]), "sigma_g must be one value or one per joint"),
        (GaussianFilter([1.0, 2.0, 3.0]), "sigma_t must be one value or one per joint"),
        (LinearFilter(torch.ones(3, 4)), "mask must have one column or 2, got 4"),
    ):
        with pytest.raises(ValueError, match=message):
            run(q)


def test_B2_one_frame_is_kept(run, rng, dtype):
    q = random_rotations(1, 3, rng=rng, dtype=dtype)
    assert_same_rotation(run(q), q)


@pytest.mark.parametrize("frames", [2, 3, 4, 5, 6, 9, 10, 11])
def test_B3_lengths_around_the_window(frames, run, rng):
    assert run(smooth_motion(frames=frames, rng=rng)).isfinite().all()


@pytest.mark.parametrize("shape", [(3, 4), (4, 3), (3, 3), (4, 4)])
def test_B5_axes_of_3_and_4_are_not_taken_for_components(shape, rng):
    batch, frames = shape
    q = random_rotations(batch, frames, 3, rng=rng)
    for run in ALL.values():
        assert torch.equal(run(q), torch.stack([run(item) for item in q]))


def test_B6_leading_axes(run, rng):
    q = smooth_motion(4, rng=rng)
    assert torch.equal(run(q.reshape(2, 1, 2, *q.shape[1:])), run(q).reshape(2, 1, 2, *q.shape[1:]))
    with pytest.raises(ValueError, match=r"got \(20, 4\)\. For one joint add a joint axis: q\[:, "):
        run(q[0, :, 0])


@pytest.mark.parametrize("function", [*ALL.values(), validity, fill_missing, lifting_denoiser])
def test_B7_B8_other_shapes_and_types(function):
    good = torch.ones(5, 3, 4)
    for bad in (torch.ones(5, 3, 3), torch.ones(5, 3, 5), torch.ones(()), torch.ones(4)):
        with pytest.raises(ValueError, match=r"q must have shape \(\.\.\., T, J, 4\), got \("):
            function(bad)
    for bad in (good.int(), good.bool(), good.to(torch.complex64)):
        with pytest.raises(TypeError, match=f"q must be a floating-point tensor, got {bad.dtype}"):
            function(bad)
    for bad in (good.numpy(), good.tolist(), None):
        kind = type(bad).__name__
        with pytest.raises(TypeError, match=rf"q must be a torch\.Tensor, got {kind}\."):
            function(bad)


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_B9_dtypes(kind, run, rng):
    q = smooth_motion(rng=rng).to(kind)
    q[3] = 0.0
    q[4:7] = IDENTITY.to(kind)
    q[7] = -q[6]
    q[8, :, :] = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=kind)
    q.requires_grad_()
    result = run(q)
    assert result.dtype == kind and q.dtype == kind
    assert_same_rotation(result, run(q.detach().double()), BOUND[kind])
    result.float().cumsum(-1).sum().backward()
    assert q.grad.isfinite().all()


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16])
def test_B10_autocast_changes_nothing(kind, run, rng):
    q = smooth_motion(rng=rng, dtype=torch.float32)
    with torch.autocast("cpu", dtype=kind):
        result = run(q)
    assert result.dtype == torch.float32
    assert_same_rotation(result, run(q), 1e-6)
    assert (result.norm(dim=-1) - 1).abs().max() < 1e-6


def test_B11_the_default_dtype_has_no_effect(run, rng):
    q = smooth_motion(rng=rng, dtype=torch.float32)
    expected = run(q)
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(run(q), expected)
        assert GaussianFilter(1.5).log_sigma_t.dtype == torch.float32
    finally:
        torch.set_default_dtype(torch.float32)


@pytest.mark.parametrize("gaps", [False, True])
def test_B11_the_default_device_has_no_effect(gaps, run, rng):
    """Nothing is made on it: what is would stay empty, and could not be added to the input."""
    q = smooth_motion(rng=rng)
    q[3:5, 1] = torch.nan if gaps else 0.5
    weight = torch.rand(20, 3, generator=rng, dtype=q.dtype) if gaps else None
    expected = run(q, weight)
    with torch.device("meta"):
        assert torch.equal(run(q, weight), expected)


def test_B12_views(run, rng):
    q = smooth_motion(2, rng=rng)
    wide = smooth_motion(2, frames=40, rng=rng)
    views = (
        q.transpose(0, 1).contiguous().transpose(0, 1),
        wide[:, ::2],
        q[:1].expand(3, *q.shape[1:]),
        q.movedim(-1, 0).contiguous().movedim(0, -1),
    )
    for view in views:
        assert torch.equal(run(view), run(view.contiguous()))


def test_B14_weights_of_another_dtype_or_kind(run, rng):
    q = smooth_motion(rng=rng)
    with pytest.raises(TypeError, match=r"dtype torch\.bool or torch\.float64 as q, got torch\.fl"):
        run(q, torch.ones(20, 3))
    with pytest.raises(TypeError, match=r"got torch\.int64"):
        run(q, torch.ones(20, 3).long())
    with pytest.raises(TypeError, match=r"weight must be a torch\.Tensor, got ndarray"):
        run(q, np.ones((20, 3)))
    with pytest.raises(ValueError, match="weight must be on cpu as q, got meta"):
        run(q, torch.ones(20, 3, dtype=q.dtype, device="meta"))


def test_B15_masks_of_another_shape_and_empty_masks(run, rng):
    q = smooth_motion(rng=rng)
    for shape in ((20,), (3, 20), (2, 20, 3), (20, 3, 1)):
        with pytest.raises(ValueError, match=r"broadcast to \(\.\.\., T, J\) = \(20, 3\), got \("):
            run(q, torch.ones(shape, dtype=torch.bool))
    # nothing is there to filter with: everything is kept as it is
    assert_same_rotation(run(q, torch.zeros(20, 3, dtype=torch.bool)), q)


def test_B16_copies(run, rng):
    q = smooth_motion(rng=rng, dtype=torch.float32)
    stream = memory.BytesIO()
    torch.save(run.state_dict(), stream)
    stream.seek(0)
    loaded = copy.deepcopy(run)
    loaded.load_state_dict(torch.load(stream, weights_only=True))
    assert torch.equal(loaded(q), run(q))
    assert_same_rotation(copy.deepcopy(run).double()(q.double()), run(q.double()), 1e-7)
    half = copy.deepcopy(run).half()(q.half())
    assert half.dtype == torch.float16 and half.isfinite().all()


def test_B17_modes(run, rng):
    q = smooth_motion(rng=rng)
    expected = run(q)
    with torch.no_grad():
        assert torch.equal(run(q), expected)
    with torch.inference_mode():
        assert torch.equal(run(q), expected)
    assert torch.equal(run.eval()(q), run.train()(q))


def test_B21_deterministic_algorithms(run, rng):
    q = smooth_motion(rng=rng).requires_grad_()
    torch.use_deterministic_algorithms(True)
    try:
        run(q).sum().backward()
    finally:
        torch.use_deterministic_algorithms(False)
    assert q.grad.isfinite().all()


@pytest.mark.parametrize(
    "size", [1, *(pytest.param(size, marks=pytest.mark.slow) for size in (40, 100))]
)
def test_B19_chunks_of_any_size_make_no_difference(size, run, rng, monkeypatch):
    """Blocks of the batch, of time, and of both; where frames are missing, and where none is."""
    q = smooth_motion(5, frames=41, rng=rng)
    gappy = q.clone()
    gappy[1, 7:12, 0] = torch.nan
    whole = [run(each) for each in (q, gappy)]
    monkeypatch.setattr(_blocks, "BLOCK", size)
    for each, expected in zip((q, gappy), whole, strict=True):
        assert torch.equal(run(each), expected)
        slope = run(each.clone().requires_grad_())
        assert_same_rotation(slope.detach(), expected)
