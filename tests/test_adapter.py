"""Filters in other representations: layouts, branches of rotation vectors, transforms."""

import math

import numpy as np
import pytest
import torch
from motions import assert_same_rotation, smooth_motion
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from torchquat import BilateralFilter, GaussianFilter
from torchquat.representation import RepresentationAdapter, continuous_rotvec, convert

SHAPES = {
    "quat_xyzw": (4,),
    "quat_wxyz": (4,),
    "rotvec": (3,),
    "rotmat": (3, 3),
    "rot6d": (6,),
    "rot6d_rows": (6,),
    "euler:ZXY_deg": (3,),
}
FILTER = GaussianFilter(1.5)


class Untouched(nn.Module):
    """Gives back what it gets."""

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        return q


def nearest_branch(q: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Frame by frame, the best of eleven branches; one joint ``(T, 4)``."""
    result, before = [], start
    for v in Rotation.from_quat(q).as_rotvec():
        axis = v / np.linalg.norm(v)
        options = [v + 2 * np.pi * n * axis for n in range(-5, 6)]
        before = min(options, key=lambda option: np.linalg.norm(option - before))
        result.append(before)
    return np.stack(result)


@pytest.mark.parametrize("name", SHAPES)
def test_is_the_filter_between_two_conversions(rng, name, dtype):
    q = smooth_motion(2, frames=12, joints=3, rng=rng)
    x = convert(q, "quat_xyzw", name).to(dtype)
    result = RepresentationAdapter(FILTER, name)(x)
    assert result.shape == x.shape and result.dtype == dtype
    expected = FILTER(convert(x, name, "quat_xyzw"))
    assert_same_rotation(convert(result, name, "quat_xyzw"), expected, 1e-5)


@pytest.mark.parametrize("name", SHAPES)
def test_flat_rows_are_the_same_numbers(rng, name):
    q = smooth_motion(2, frames=8, joints=24, rng=rng)
    x = convert(q, "quat_xyzw", name)
    rows = x.reshape(2, 8, -1)
    assert rows.shape[-1] == 24 * math.prod(SHAPES[name])
    flat = RepresentationAdapter(FILTER, name, joints=24)(rows)
    assert torch.equal(flat, RepresentationAdapter(FILTER, name)(x).reshape(rows.shape))


def test_weights_and_gaps_reach_the_filter(rng):
    q = smooth_motion(frames=10, joints=2, rng=rng)
    x = convert(q, "quat_xyzw", "rotmat")
    x[4, 1] = torch.nan
    weight = torch.rand(10, 2, generator=rng, dtype=torch.float64)
    result = RepresentationAdapter(FILTER, "rotmat")(x, weight)
    gap = weight.clone()
    gap[4, 1] = 0
    assert torch.isfinite(result).all()
    assert_same_rotation(convert(result, "rotmat", "quat_xyzw"), FILTER(q, gap))


@pytest.mark.parametrize("turns", [0.4, 1.0, 2.3])
@pytest.mark.parametrize("start", [0, 1, -2])
def test_E10_rotation_vectors_take_the_branch_nearest_to_the_frame_before(rng, turns, start):
    """A wobbling axis, and an angle that passes half and full turns."""
    time = torch.linspace(0, 1, 150, dtype=torch.float64)[:, None]
    axis = torch.tensor([[0.5, -0.3, 0.8]], dtype=torch.float64)
    axis = axis + 0.1 * torch.cat([time.sin(), (3 * time).cos(), time], -1)
    axis = axis / axis.norm(dim=-1, keepdim=True)
    v = (0.3 + 2 * math.pi * turns * time) * axis
    q = convert(v, "rotvec", "quat_xyzw")
    q[::7] *= -1
    first = v[0] + 2 * math.pi * start * axis[0]
    result = continuous_rotvec(q[:, None], first[None])[:, 0]
    assert torch.allclose(result, torch.from_numpy(nearest_branch(q.numpy(), first.numpy())))
    assert result.diff(dim=0).norm(dim=-1).max() < 0.5
    assert_same_rotation(convert(result, "rotvec", "quat_xyzw"), q)


def test_the_branches_of_any_motion_are_those_of_a_search_frame_by_frame(rng):
    q = smooth_motion(frames=200, joints=10, rng=rng)
    result = continuous_rotvec(q)
    for joint in range(10):
        expected = nearest_branch(q[:, joint].numpy(), np.zeros(3))
        assert np.allclose(result[:, joint], expected)
    assert_same_rotation(convert(result, "rotvec", "quat_xyzw"), q)
    assert (result.norm(dim=-1) > math.pi).any()


def test_an_estimator_that_flips_at_half_turns_comes_back_smooth():
    """The vectors of a slow turn through pi, as networks write them: at most pi long."""
    angle = torch.linspace(2.8, 3.6, 30, dtype=torch.float64)
    v = torch.zeros(30, 1, 3, dtype=torch.float64)
    v[:, 0, 1] = torch.where(angle > math.pi, angle - 2 * math.pi, angle)
    assert v.diff(dim=0).abs().max() > 6
    result = RepresentationAdapter(Untouched(), "rotvec")(v)
    assert torch.allclose(result[:, 0, 1], angle)
    beyond = v + torch.tensor([0.0, 4 * math.pi, 0.0], dtype=torch.float64)
    assert torch.allclose(
        RepresentationAdapter(Untouched(), "rotvec")(beyond)[:, 0, 1], angle + 4 * math.pi
    )


def test_the_branch_is_that_of_the_first_present_frame(rng):
    """Missing frames before it say nothing, whatever stands there."""
    v = torch.tensor([5.5, 0.0, 0.0]) + 0.05 * torch.randn(8, 2, 3, generator=rng)
    weight = torch.ones(8, 2)
    weight[0, 0] = weight[:2, 1] = 0.0
    run = RepresentationAdapter(FILTER, "rotvec")
    expected = run(v, weight)
    assert torch.allclose(expected[..., 0], torch.tensor(5.5), atol=0.3)
    for garbage in ([torch.nan] * 3, [0.1, 0.0, 0.0], [18.0, 0.0, 0.0], [0.0, 0.0, 0.0]):
        spoilt = torch.where(weight[..., None] > 0, v, torch.tensor(garbage))
        assert torch.allclose(run(spoilt, weight), expected, atol=1e-5)
    spoilt = torch.where(weight[..., None] > 0, v, torch.nan)
    assert torch.allclose(run(spoilt), expected, atol=1e-5)


def test_no_rotation_after_full_turns_keeps_the_axis():
    angle = torch.tensor([5.0, 2 * math.pi, 2 * math.pi, 7.0], dtype=torch.float64)
    q = torch.zeros(4, 1, 4, dtype=torch.float64)
    q[:, 0, 0], q[:, 0, 3] = (angle / 2).sin(), (angle / 2).cos()
    q[1:3] = torch.tensor([0.0, 0.0, 0.0, -1.0], dtype=torch.float64)
    result = continuous_rotvec(q, torch.tensor([[5.0, 0.0, 0.0]], dtype=torch.float64))
    assert torch.allclose(result[:, 0, 0], angle) and (result[:, 0, 1:] == 0).all()


def test_missing_frames_are_passed_over_and_stay_missing():
    v = torch.zeros(6, 1, 3, dtype=torch.float64)
    v[:, 0, 0] = torch.tensor([2.9, 3.3, 3.7, 4.1, 4.5, 4.9])
    q = convert(v, "rotvec", "quat_xyzw")
    q[1:4] = torch.nan
    result = continuous_rotvec(q)
    assert result[1:4].isnan().all()
    assert torch.allclose(result[[0, 4, 5]], v[[0, 4, 5]])


def test_another_axis_starts_anew():
    v = torch.tensor([[3.0, 0, 0], [4.0, 0, 0], [5.0, 0, 0], [0, 1.0, 0], [0, 1.2, 0], [0, 4.0, 0]])
    q = convert(v.double(), "rotvec", "quat_xyzw")
    assert torch.allclose(continuous_rotvec(q[:, None])[:, 0], v.double())


def test_a_first_frame_that_is_missing_asks_for_short_vectors(rng):
    x = 0.3 * torch.randn(6, 2, 3, generator=rng, dtype=torch.float64)
    x[0, 0] = torch.nan
    result = RepresentationAdapter(FILTER, "rotvec")(x)
    assert torch.isfinite(result).all() and result.norm(dim=-1).max() < math.pi


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("frames", [0, 1, 2])
def test_B1_B2_short_sequences(rng, name, frames):
    x = convert(smooth_motion(frames=frames, joints=2, rng=rng), "quat_xyzw", name)
    result = RepresentationAdapter(FILTER, name)(x)
    assert result.shape == x.shape and torch.isfinite(result).all()
    if frames == 1:
        assert torch.allclose(result, x)


@pytest.mark.parametrize("name", SHAPES)
def test_gradients_and_vmap(rng, name):
    q = smooth_motion(3, frames=4, joints=1, rng=rng)
    x = convert(q, "quat_xyzw", name).requires_grad_()
    adapter = RepresentationAdapter(GaussianFilter(1.0), name)
    assert torch.autograd.gradcheck(adapter, x[:1].detach().requires_grad_())
    looped = torch.stack([adapter(each) for each in x])
    assert torch.allclose(torch.func.vmap(adapter)(x), looped, atol=1e-12)
    x_missing = x.detach().clone()
    x_missing[0, 1] = torch.nan
    x_missing.requires_grad_()
    adapter(x_missing).square().sum().backward()
    assert x_missing.grad is not None and torch.isfinite(x_missing.grad).all()
    assert (x_missing.grad[0, 1] == 0).all()


def test_derivatives_of_vectors_beyond_a_half_turn(rng):
    angle = torch.linspace(2.0, 8.0, 5, dtype=torch.float64)
    axis = torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64)
    v = (angle[:, None] * axis)[:, None].requires_grad_()
    adapter = RepresentationAdapter(Untouched(), "rotvec")
    assert torch.allclose(adapter(v), v)
    assert torch.autograd.gradcheck(adapter, v) and torch.autograd.gradgradcheck(adapter, v)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quat_wxyz", "rotvec", "rotmat", "rot6d", "euler:ZXY_deg"])
def test_C1_compiles_whole(rng, name):
    torch._dynamo.reset()
    adapter = RepresentationAdapter(BilateralFilter(1.0, 0.5), name)
    x = convert(smooth_motion(2, frames=9, joints=2, rng=rng), "quat_xyzw", name)
    x[0, 3, 1] = torch.nan
    compiled = torch.compile(adapter, fullgraph=True, backend="aot_eager")
    mine, theirs = x.clone().requires_grad_(), x.clone().requires_grad_()
    a, b = compiled(mine), adapter(theirs)
    assert torch.allclose(a, b, atol=1e-10)
    a.square().sum().backward()
    b.square().sum().backward()
    assert mine.grad is not None and theirs.grad is not None
    assert torch.allclose(mine.grad, theirs.grad, atol=1e-8)


def test_half_precision_and_state(rng):
    x = convert(smooth_motion(frames=8, joints=2, rng=rng), "quat_xyzw", "rotmat").half()
    weight = torch.ones(8, 2, dtype=torch.float16)
    adapter = RepresentationAdapter(BilateralFilter(1.0, 0.5, learnable=True), "rotmat")
    assert adapter(x, weight).dtype == torch.float16
    assert len(list(adapter.parameters())) == 2
    assert "'rotmat', joints=None" in repr(adapter)


@pytest.mark.parametrize(
    ("name", "joints", "shape", "match"),
    [
        ("rotmat", None, (10, 24, 9), r"\(\.\.\., 3, 3\) as rotmat, got \(10, 24, 9\)"),
        ("rotmat", None, (10, 3, 3), r"T, J, 3, 3\) as rotmat, got \(10, 3, 3\).*joints=24"),
        ("rotvec", None, (10, 72), r"\(\.\.\., 3\) as rotvec, got \(10, 72\)"),
        ("rotvec", 24, (10, 66), r"T, 72\) as rotvec of 24 joints, got \(10, 66\)"),
        ("rotvec", 24, (10, 24, 3), r"T, 72\) as rotvec of 24 joints, got \(10, 24, 3\)"),
        ("rot6d", 24, (144,), r"T, 144\) as rot6d of 24 joints, got \(144,\)"),
    ],
)
def test_errors_say_what_was_got_and_wanted(name, joints, shape, match):
    with pytest.raises(ValueError, match=match):
        RepresentationAdapter(FILTER, name, joints=joints)(torch.zeros(shape))


def test_errors_at_construction_and_for_types():
    with pytest.raises(ValueError, match="got 'matrix'"):
        RepresentationAdapter(FILTER, "matrix")
    with pytest.raises(ValueError, match="joints must be >= 1, got 0"):
        RepresentationAdapter(FILTER, "rotvec", joints=0)
    with pytest.raises(TypeError, match="got ndarray"):
        RepresentationAdapter(FILTER, "rotvec", joints=1)(np.zeros((2, 3)))  # type: ignore
