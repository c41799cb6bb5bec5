"""Rotations against scipy and matrices, and their derivatives where formulas break."""

import math
from itertools import product

import numpy as np
import pytest
import torch
from motions import IDENTITY, angle_between, assert_same_rotation, numpy_of, random_rotations
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck, gradgradcheck

from torchquat import _series, so3

AXES = [axis for axis in product((-1.0, 0.0, 1.0), repeat=3) if any(axis)]


def turn(angle, axis=(0.0, 0.0, 1.0), dtype=torch.float64):
    """Quaternions of angles ``(...)`` about one axis, by the definition."""
    axis = torch.tensor(axis, dtype=torch.float64) / math.hypot(*axis)
    angle = torch.as_tensor(angle, dtype=torch.float64)[..., None]
    return torch.cat([(angle / 2).sin() * axis, (angle / 2).cos()], -1).to(dtype)


@pytest.mark.parametrize(
    ("axis", "point", "image"),
    [
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        # Rodrigues: (1, 1, 1) / 3 + (0, 1, -1) / sqrt 3
        ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0), (1 / 3, 0.9106836025229592, -0.2440169358562925)),
    ],
)
def test_A24_components_are_xyzw_and_turns_active(axis, point, image):
    """90 degrees about z sends x to y."""
    moved = so3.rotate(turn(math.pi / 2, axis), torch.tensor(point).double())
    assert torch.allclose(moved, torch.tensor(image).double(), atol=1e-12)


def test_A24_compose_applies_the_second_first():
    about_x, about_z = turn(math.pi / 2, (1.0, 0.0, 0.0)), turn(math.pi / 2)
    z = torch.tensor([0.0, 0.0, 1.0]).double()
    assert torch.allclose(
        so3.rotate(so3.compose(about_z, about_x), z), torch.tensor([1.0, 0, 0]).double()
    )
    assert torch.allclose(
        so3.rotate(so3.compose(about_x, about_z), z), torch.tensor([0, -1.0, 0]).double()
    )


def test_agrees_with_scipy(rng):
    a, b = random_rotations(50, rng=rng), random_rotations(50, rng=rng)
    first, second = Rotation.from_quat(numpy_of(a)), Rotation.from_quat(numpy_of(b))
    assert_same_rotation(so3.compose(a, b), torch.from_numpy((first * second).as_quat()))
    assert_same_rotation(so3.inverse(a), torch.from_numpy(first.inv().as_quat()))
    assert torch.allclose(so3.log(a), torch.from_numpy(first.as_rotvec()), atol=1e-12)
    assert_same_rotation(so3.exp(so3.log(a)), a)
    relative = (first.inv() * second).magnitude()
    assert torch.allclose(so3.distance(a, b), torch.from_numpy(relative), atol=1e-12)
    point = torch.randn(50, 3, generator=rng, dtype=torch.float64)
    assert torch.allclose(so3.rotate(a, point), torch.from_numpy(first.apply(point.numpy())))


def test_rotation_vectors_live_in_the_body_frame(rng):
    q, v = random_rotations(9, rng=rng), torch.randn(9, 3, generator=rng, dtype=torch.float64)
    assert torch.allclose(so3.log(so3.relative(q, so3.compose(q, so3.exp(v)))), v, atol=1e-12)


@pytest.mark.parametrize("angle", [1e-30, 1e-20, 1e-10, 1e-6, 1e-4, 1e-2, 0.1, 1.0, 3.0])
def test_A7_small_angles_keep_their_relative_precision(angle, dtype):
    v = angle * torch.tensor([2.0, -1.0, 2.0], dtype=dtype) / 3.0
    q = so3.exp(v)
    assert torch.allclose(so3.log(q), v, rtol=1e-5, atol=0.0)
    assert so3.distance(IDENTITY.to(dtype), q).item() == pytest.approx(angle, rel=1e-5)


def test_A7_neighbours_close_to_each_other_far_from_identity(dtype, rng):
    """1e-4 rad in float32: what ``acos`` of the dot product makes 0."""
    q = random_rotations(100, rng=rng)
    near = so3.compose(q, turn(1e-4, (1.0, 2.0, 2.0)))
    # the inputs themselves are rounded to the dtype: the oracle sees the rounded ones
    q, near = q.to(dtype), near.to(dtype)
    expected = angle_between(q, near)
    for sign in (1.0, -1.0):
        error = (so3.distance(q, sign * near) - expected).abs() / expected
        assert error.max() < 1e-5, f"{error.max():.1e}"


@pytest.mark.parametrize("w", [0.0, -0.0])
@pytest.mark.parametrize("axis", AXES)
def test_A8_A10_half_turns_about_26_axes(axis, w, dtype):
    q = torch.tensor([*axis, 0.0], dtype=dtype)
    q = (q / q.norm()).clone()
    q[3] = w
    q.requires_grad_()
    v = so3.log(q)
    assert v.norm().item() == pytest.approx(math.pi, rel=1e-6)
    assert_same_rotation(so3.exp(v), q)
    matrix = torch.from_numpy(Rotation.from_quat(numpy_of(q)).as_matrix())
    image = so3.rotate(q[None], torch.eye(3, dtype=dtype))
    assert torch.allclose(image.double(), matrix.T, atol=1e-6)
    v.sum().backward()
    assert q.grad.isfinite().all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("off", [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, -1e-3, -1e-5, -1e-7])
def test_A9_near_half_turns(off, sign, dtype):
    q = sign * turn(math.pi + off, (1.0, -2.0, 2.0), dtype)
    assert so3.distance(IDENTITY.to(dtype), q).item() == pytest.approx(math.pi - abs(off), abs=1e-6)


def test_A1_A2_A12_normalize_keeps_the_direction(dtype, rng):
    q = random_rotations(20, rng=rng)
    largest = torch.finfo(dtype).max
    for norm in (1e-30, 1e-20, 0.5, 2.0, 1e20, 1e30, 0.9 * largest, -2.0):
        assert_same_rotation(so3.normalize((q * norm).to(dtype)), q.to(dtype))
    assert_same_rotation(so3.normalize(-2.0 * IDENTITY), IDENTITY)


@pytest.mark.parametrize(("dtype", "norm"), [(torch.float32, 1e-22), (torch.float64, 1e-161)])
def test_A12_small_quaternions_become_as_long_as_others(dtype, norm, rng):
    """Their squared norms are no 0, but have lost most of their digits."""
    unit = so3.normalize((random_rotations(20, rng=rng) * norm).to(dtype))
    assert (unit.double().norm(dim=-1) - 1.0).abs().max() < 4 * torch.finfo(dtype).eps


def test_A12_half_precision_at_its_end(rng):
    q = 6e4 * torch.tensor([0.0, 0.6, 0.0, 0.8], dtype=torch.float16)
    assert_same_rotation(so3.normalize(q.float()), q)


def test_A11_A15_rows_without_a_direction_are_the_identity_and_have_no_gradient():
    q = torch.tensor([[0, 0, 0, 0], [torch.nan, 0, 0, 1], [0, torch.inf, 0, 1], [0, 0, 0, -3.0]])
    q.requires_grad_()
    unit = so3.normalize(q)
    assert so3.usable(q).tolist() == [False, False, False, True]
    assert torch.equal(unit[:3], IDENTITY.float().expand(3, 4))
    unit.square().cumsum(-1).sum().backward()
    assert torch.equal(q.grad[:3], torch.zeros(3, 4)) and q.grad.isfinite().all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_A5_A6_slerp(sign, rng):
    a, b = random_rotations(20, rng=rng), random_rotations(20, rng=rng)
    halfway = so3.slerp(a, sign * b, 0.5)
    for end in (a, b):
        assert torch.allclose(angle_between(halfway, end), angle_between(a, b) / 2, atol=1e-12)
    assert_same_rotation(so3.slerp(a, sign * a, torch.tensor(0.3)), a)
    assert ((so3.slerp(a, sign * b, 0.7) * a).sum(-1) > 0).all()
    back = so3.slerp(a, so3.slerp(a, b, 0.1), -1.0)  # as far again, the other way
    assert_same_rotation(so3.slerp(back, so3.slerp(a, b, 0.1), 0.5), a)


def test_align_chooses_the_hemisphere(rng):
    a, b = random_rotations(20, rng=rng), random_rotations(20, rng=rng)
    aligned = so3.align(a, b)
    assert ((aligned * b).sum(-1) >= 0).all() and torch.equal(aligned.abs(), a.abs())
    assert torch.equal(so3.align(a, torch.zeros_like(a)), a)
    for b in (a, torch.cat([a[:1], -a[1:]])):  # one for many: of one shape, whatever the signs
        assert torch.equal(so3.align(a[0], b), so3.align(a[0].expand(20, 4), b))


POINTS = {
    "identity": IDENTITY,
    "minus identity": -IDENTITY,
    "tiny": turn(1e-7),
    "series ends": turn(2e-2, (1.0, 1.0, 0.0)),
    "middle": turn(1.3, (1.0, -2.0, 0.5)),
    "near pi": turn(math.pi - 2e-3, (1.0, 2.0, 3.0)),
    "past pi": turn(math.pi + 2e-3, (1.0, 2.0, 3.0)),
}


@pytest.mark.parametrize("point", POINTS)
def test_A1_A2_C7_first_and_second_derivatives(point):
    q = POINTS[point].clone().requires_grad_()
    other = turn(0.4, (3.0, 1.0, 2.0)).requires_grad_()
    v = so3.log(POINTS[point]).requires_grad_()
    far = so3.compose(POINTS[point], turn(0.4, (3.0, 1.0, 2.0))).requires_grad_()
    for function, inputs in (
        (lambda q: so3.log(so3.normalize(q)), (q,)),
        (so3.exp, (v,)),
        (so3.normalize, (q,)),
        (lambda a, b: so3.squared_distance(so3.normalize(a), so3.normalize(b)), (other, far)),
        (lambda a, b: so3.slerp(so3.normalize(a), so3.normalize(b), 0.3), (other, far)),
        (lambda a: so3.rotate(so3.normalize(a), so3.log(other.detach())), (q,)),
    ):
        assert gradcheck(function, inputs, eps=1e-6, atol=1e-5, rtol=1e-3)
        assert gradgradcheck(function, inputs, eps=1e-6, atol=1e-5, rtol=1e-3)


def test_A6_derivatives_between_equal_neighbours(rng):
    q = random_rotations(rng=rng)
    a, b = q.clone().requires_grad_(), q.clone().requires_grad_()
    for function in (so3.squared_distance, lambda a, b: so3.slerp(a, b, 0.3)):

        def unit(a, b, function=function):
            return function(so3.normalize(a), so3.normalize(b))

        assert gradcheck(unit, (a, b)) and gradgradcheck(unit, (a, b))
    # the distance itself has a kink there: its gradient is the middle of the fan, 0
    so3.distance(a, b).backward()
    assert torch.equal(a.grad, torch.zeros(4, dtype=a.dtype))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_C7_second_derivatives_of_log_at_identity_are_finite(dtype):
    """Roma's ``unitquat_to_rotvec`` has NaN there."""
    q = IDENTITY.to(dtype).clone().requires_grad_()
    hessian = torch.autograd.functional.hessian(lambda q: so3.log(q).sum(), q)
    assert hessian.isfinite().all()


@pytest.mark.parametrize("grad", [False, True], ids=["plain", "series"])
def test_functions_with_a_removable_singularity_have_all_their_digits(grad):
    """Both forms, near the singularity and away from it, against NumPy."""
    square = np.logspace(-12, np.log10(0.5), 400)
    root = np.sqrt(square)
    x = torch.from_numpy(square).requires_grad_(grad)
    sinc, cosine = _series.sinc_and_cosine(x)
    squared_angle, factor = _series.squared_angle_and_factor(x)
    expected_factor = 2 * np.arcsin(root) / (root * np.sqrt(1 - square))
    for actual, expected in (
        (_series.squared_arcsine(x), np.arcsin(root) ** 2),
        (_series.angle_over_half_sine(x), expected_factor),
        (factor, expected_factor),
        (squared_angle, 16 * np.arcsin(root) ** 2),
        (sinc, np.sin(root) / root),
        (cosine, np.cos(root)),
    ):
        assert np.abs(actual.detach().numpy() / expected - 1.0).max() < 2e-15


def test_midpoints(rng):
    """Halfway on the short arc, in the hemisphere of the first."""
    a, b = random_rotations(2, 50, rng=rng)
    for other in (b, -b):
        half = so3.midpoint(a, other)
        assert_same_rotation(half, so3.slerp(a, other, 0.5), 1e-12)
        assert ((half * a).sum(-1) > 0).all()
        assert torch.allclose(half.norm(dim=-1), torch.ones(50).double(), atol=1e-12)


def test_turns_both_ways(rng):
    q, v = random_rotations(20, rng=rng), torch.randn(20, 3, generator=rng).double()
    ahead, back = so3.turn_both_ways(q, v)
    assert_same_rotation(ahead, so3.turn(q, v), 1e-12)
    assert_same_rotation(back, so3.turn(q, -v), 1e-12)


def test_A7_distances_of_every_size_side_by_side():
    """Angles whose squares underflow beside large ones and none."""
    angle = torch.tensor([0.0, 1e-30, 1e-22, 1e-4, 0.5, 3.0])
    q = so3.exp(torch.stack([angle, 0 * angle, 0 * angle], -1))
    found = so3.distance(torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(6, 4), q)
    assert found[0] == 0 and torch.allclose(found, angle, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_B9_the_dtype_stays(dtype, rng):
    q, v = random_rotations(5, rng=rng).to(dtype), torch.ones(5, 3, dtype=dtype)
    made = [so3.exp(v), so3.log(q), so3.compose(q, q), so3.inverse(q), so3.between(q, q.flip(0))]
    made += [so3.turn(q, v), so3.rotate(q, v), so3.slerp(q, q.flip(0), 0.3), so3.normalize(q)]
    made += [so3.align(q, -q), so3.distance(q, q.flip(0)), so3.midpoint(q, q.flip(0))]
    assert {each.dtype for each in made} == {dtype}


def test_B11_the_default_device_has_no_effect(rng):
    q, v = random_rotations(5, rng=rng), torch.ones(5, 3).double()
    odd = torch.cat([q[:3], 1e200 * q[3:4], torch.zeros(1, 4).double()])
    calls = {
        "normalize": lambda: so3.normalize(odd),
        "inverse": lambda: so3.inverse(q),
        "turn": lambda: so3.turn(q, v),
        "slerp": lambda: so3.slerp(q, q.roll(1, 0), 0.3),
        "distance": lambda: so3.distance(q, q.roll(1, 0)),
        "rotate": lambda: so3.rotate(q, v),
    }
    expected = {name: call() for name, call in calls.items()}
    with torch.device("meta"):
        for name, call in calls.items():
            assert torch.equal(call(), expected[name]), name
