"""Conversions against scipy and NumPy: values, layouts, singular points, derivatives, gaps."""

import itertools
import math

import numpy as np
import pytest
import torch
from motions import BOUND, assert_same_rotation, random_rotations
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck, gradgradcheck

from torchquat.representation import convert

ORDERS = [
    "".join(order)
    for axes in ("XYZ", "xyz")
    for order in itertools.product(axes, repeat=3)
    if order[1] not in (order[0], order[2])
]
EULERS = [f"euler:{order}" for order in ORDERS]
OTHERS = ["quat_wxyz", "rotvec", "rotmat", "rot6d", "rot6d_columns", "rot6d_rows"]
NAMES = [*OTHERS, "euler:ZXY", "euler:xyz_deg", "euler:ZXZ"]
HALF = math.sqrt(0.5)
AXES = [axis for axis in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(axis)]


def special_rotations() -> Rotation:
    """The identity, half turns about 26 axes and beside them, quarter turns: gimbal lock."""
    axes = np.array(AXES) / np.linalg.norm(AXES, axis=-1, keepdims=True)
    angles = [math.pi, math.pi - 1e-7, math.pi - 1e-3, 1e-9, 1e-4, math.pi / 2]
    turns = np.concatenate([np.zeros((1, 3)), *(angle * axes for angle in angles)])
    locked = [
        Rotation.from_euler("XYZ", [0.3, sign * (math.pi / 2 - off), -0.5])
        for sign in (1, -1)
        for off in (0.0, 1e-12, 1e-7, 1e-4)
    ]
    return Rotation.concatenate([Rotation.from_rotvec(turns), *locked])


def expected(r: Rotation, name: str) -> np.ndarray:
    """What scipy and slices of its matrices say."""
    matrix = r.as_matrix()
    if name.startswith("euler:"):
        order = name.removeprefix("euler:").removesuffix("_deg")
        return r.as_euler(order, degrees=name.endswith("_deg"))
    return {
        "quat_wxyz": lambda: r.as_quat(scalar_first=True),
        "rotvec": r.as_rotvec,
        "rotmat": lambda: matrix,
        "rot6d": lambda: np.stack([matrix[:, i, j] for i in range(3) for j in range(2)], -1),
        "rot6d_columns": lambda: np.concatenate([matrix[:, :, 0], matrix[:, :, 1]], -1),
        "rot6d_rows": lambda: np.concatenate([matrix[:, 0], matrix[:, 1]], -1),
    }[name]()


@pytest.mark.parametrize("name", [*OTHERS, *EULERS, "euler:ZXY_deg"])
def test_agrees_with_scipy_both_ways(rng, name):
    r = Rotation.from_quat(random_rotations(200, rng=rng).numpy())
    r = Rotation.from_rotvec(r.as_rotvec())  # w >= 0
    theirs = torch.from_numpy(expected(r, name))
    q = torch.from_numpy(r.as_quat())
    ours = convert(q, "quat_xyzw", name)
    assert torch.allclose(ours, theirs, rtol=1e-12, atol=1e-12)
    assert_same_rotation(convert(theirs, name, "quat_xyzw"), q)


@pytest.mark.parametrize("name", [*OTHERS, *EULERS])
def test_special_rotations_come_back(name, dtype):
    q = torch.from_numpy(special_rotations().as_quat()).to(dtype)
    there = convert(q, "quat_xyzw", name)
    assert torch.isfinite(there).all()
    assert_same_rotation(convert(there, name, "quat_xyzw"), q, 2 * BOUND[dtype])


def test_small_angles_survive_between_vectors_and_quaternions():
    v = torch.tensor([[1e-4, -2e-5, 3e-9]])
    back = convert(convert(v, "rotvec", "quat_wxyz"), "quat_wxyz", "rotvec")
    assert torch.allclose(back, v, rtol=1e-6, atol=0)


def test_layouts_of_two_columns_and_of_two_rows():
    """A quarter turn about z sends x to y: R = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]."""
    q = torch.tensor([0.0, 0.0, HALF, HALF], dtype=torch.float64)
    for name, numbers in (
        ("rot6d", [0, -1, 1, 0, 0, 0]),
        ("rot6d_columns", [0, 1, 0, -1, 0, 0]),
        ("rot6d_rows", [0, -1, 0, 1, 0, 0]),
    ):
        there = torch.tensor(numbers, dtype=torch.float64)
        assert torch.allclose(convert(q, "quat_xyzw", name), there, atol=1e-15), name
        assert_same_rotation(convert(there, name, "quat_xyzw"), q)


@pytest.mark.parametrize("order", ["ZXY", "zyx", "XZX", "yxy"])
def test_in_gimbal_lock_the_third_angle_is_0_as_in_scipy(order):
    symmetric = order[0] == order[2]
    for middle in (0.0, math.pi) if symmetric else (math.pi / 2, -math.pi / 2):
        r = Rotation.from_euler(order, [0.4, middle, 0.7])
        angles = convert(torch.from_numpy(r.as_quat()), "quat_xyzw", f"euler:{order}")
        assert angles[2] == 0
        back = Rotation.from_euler(order, angles.numpy())
        assert (back * r.inv()).magnitude() < 1e-7  # scipy calls it lock a little away from it too


def test_matrices_are_projected_to_the_nearest_rotation(rng):
    m = torch.randn(300, 3, 3, generator=rng, dtype=torch.float64)
    u, _, vt = np.linalg.svd(m.numpy())
    u[..., 2] *= np.linalg.det(u @ vt)[:, None]
    projected = convert(convert(m, "rotmat", "quat_xyzw"), "quat_xyzw", "rotmat")
    assert np.allclose(projected, u @ vt, atol=1e-10)
    scaled = convert(1e30 * m, "rotmat", "quat_xyzw")
    assert_same_rotation(scaled, convert(m, "rotmat", "quat_xyzw"))


def test_two_vectors_are_made_orthonormal_from_the_first(rng):
    x = torch.randn(100, 6, generator=rng, dtype=torch.float64)
    a, b = x[:, :3].numpy(), x[:, 3:].numpy()
    first = a / np.linalg.norm(a, axis=-1, keepdims=True)
    third = np.cross(a, b)
    third /= np.linalg.norm(third, axis=-1, keepdims=True)
    matrix = np.stack([first, np.cross(third, first), third], -1)
    q = torch.from_numpy(Rotation.from_matrix(matrix).as_quat())
    assert_same_rotation(convert(x, "rot6d_columns", "quat_xyzw"), q)


def points(name: str) -> torch.Tensor:
    """Where there is danger: identity, half turns, gimbal lock, no rotation at all."""
    r = special_rotations()
    x = (
        torch.from_numpy(expected(r, name))
        if name != "quat_xyzw"
        else torch.from_numpy(r.as_quat())
    )
    broken = {
        "rotmat": [torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.ones(3, 3), -torch.eye(3)],
        "rot6d": [torch.tensor([1.0, 2, 1, 2, 1, 2]), torch.tensor([0.0, 1, 0, 0, 0, 0])],
        "rot6d_columns": [torch.tensor([0, 0, 1.0, 0, 0, -2])],
        "rot6d_rows": [torch.tensor([1.0, 2, 3, 0, 0, 0])],
    }.get(name, [])
    return torch.cat([x, *(each.double()[None] for each in broken)])


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@pytest.mark.parametrize("name", ["quat_xyzw", *NAMES])
def test_first_and_second_derivatives_are_finite_everywhere(name, dtype):
    for dst in ("quat_xyzw", *NAMES):
        x = points(name).to(dtype).requires_grad_()
        y = convert(x, name, dst)
        assert torch.isfinite(y).all(), dst
        weights = torch.linspace(-1.0, 1.5, y.numel(), dtype=dtype).reshape(y.shape)
        (slope,) = torch.autograd.grad((weights * y).sum(), x, create_graph=True)
        assert torch.isfinite(slope).all(), dst
        if slope.requires_grad:
            (curvature,) = torch.autograd.grad(slope.square().sum().sqrt(), x)
            assert torch.isfinite(curvature).all(), dst


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_right(rng, name):
    q = random_rotations(2, rng=rng)
    identity = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
    q = torch.cat([q, identity]).requires_grad_()
    x = convert(q.detach(), "quat_xyzw", name)
    x[0] += 0.1 * torch.randn(x[0].shape, generator=rng, dtype=x.dtype)  # not orthonormal
    x.requires_grad_()
    mix = torch.randn(4, 4, generator=rng, dtype=torch.float64)

    def there(q):
        return convert(q, "quat_xyzw", name)

    def back(x):
        turned = convert(x, name, "quat_xyzw")
        return (turned @ mix * turned).sum(-1)  # the same for q and -q

    if name != "euler:ZXZ":  # in lock at the identity
        assert gradcheck(there, q) and gradgradcheck(there, q, atol=1e-4)
    assert gradcheck(back, x) and gradgradcheck(back, x, atol=1e-4)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["quat_xyzw", *NAMES])
def test_A14_A15_what_is_not_finite_stays_missing_and_alone(rng, name, bad):
    q = random_rotations(5, rng=rng)
    clean = convert(q, "quat_xyzw", name)
    broken = clean.clone()
    broken[2].view(-1)[0] = bad
    for dst in ("quat_xyzw", "rotvec", "rotmat", "rot6d", "euler:ZXY"):
        if dst == name:
            continue
        x = broken.clone().requires_grad_()
        y = convert(x, name, dst)
        others = [0, 1, 3, 4]
        assert torch.equal(y[others], convert(clean, name, dst)[others])
        if {name, dst} != {"quat_xyzw", "quat_wxyz"}:
            assert y[2].isnan().all()
        y[others].square().sum().backward()
        assert x.grad is not None and (x.grad[2] == 0).all() and torch.isfinite(x.grad).all()


@pytest.mark.parametrize("name", ["quat_xyzw", "quat_wxyz", "rotmat", "rot6d", "rot6d_rows"])
def test_A11_all_zeros_are_missing(name):
    shape = {"rotmat": (3, 3), "rot6d": (6,), "rot6d_rows": (6,)}.get(name, (4,))
    x = torch.zeros(2, *shape, requires_grad=True)
    y = convert(x, name, "rotvec")
    assert y.isnan().all()
    y.nansum().backward()
    assert x.grad is not None and (x.grad == 0).all()


def test_B10_autocast_leaves_derivatives_of_matrices_alone(rng):
    """Products of matrices would have half their digits."""
    q = random_rotations(9, 2, rng=rng, dtype=torch.float32)
    m = convert(q, "quat_xyzw", "rotmat") + 0.05 * torch.randn(9, 2, 3, 3, generator=rng)
    slopes = []
    for enabled in (False, True):
        own = m.clone().requires_grad_()
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            convert(own, "rotmat", "quat_xyzw")[..., 3].sum().backward()
        slopes.append(own.grad)
    assert torch.allclose(slopes[1], slopes[0], atol=1e-5)


def test_quaternions_keep_their_numbers_and_the_same_name_returns_the_input():
    q = torch.tensor([[1.0, -2.0, 3.0, -4.0]])
    assert torch.equal(convert(q, "quat_xyzw", "quat_wxyz"), torch.tensor([[-4.0, 1.0, -2.0, 3.0]]))
    assert torch.equal(convert(convert(q, "quat_xyzw", "quat_wxyz"), "quat_wxyz", "quat_xyzw"), q)
    assert convert(q, "quat_xyzw", "quat_xyzw") is q


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_B9_half_precision_in_and_out(rng, half):
    q = random_rotations(20, rng=rng).to(half)
    m = convert(q, "quat_xyzw", "rotmat")
    assert m.dtype == half
    assert_same_rotation(convert(m, "rotmat", "quat_xyzw"), q, 4 * BOUND[half])


@pytest.mark.parametrize("shape", [(), (0,), (2, 0, 3), (2, 1, 3)])
def test_any_leading_shape(shape, rng):
    q = random_rotations(*shape, rng=rng)
    for name in NAMES:
        there = convert(q, "quat_xyzw", name)
        assert there.shape[: len(shape)] == shape
        assert convert(there, name, "quat_xyzw").shape == q.shape


@pytest.mark.parametrize("name", NAMES)
def test_C4_vmap_is_the_plain_loop(rng, name):
    q = random_rotations(4, 3, rng=rng)
    there = torch.func.vmap(lambda q: convert(q, "quat_xyzw", name))(q)
    assert torch.allclose(there, convert(q, "quat_xyzw", name), atol=1e-13)
    back = torch.func.vmap(lambda x: convert(x, name, "quat_xyzw"))(there)
    assert_same_rotation(back, q)


@pytest.mark.parametrize(
    ("x", "src", "dst", "error", "match"),
    [
        (torch.zeros(4), "xyzw", "rotvec", ValueError, "one of quat_xyzw.*got 'xyzw'"),
        (torch.zeros(3), "euler:XXY", "rotvec", ValueError, "got 'euler:XXY'"),
        (torch.zeros(3), "euler:XyZ", "rotvec", ValueError, "got 'euler:XyZ'"),
        (torch.zeros(3), "euler:XY", "rotvec", ValueError, "got 'euler:XY'"),
        (torch.zeros(4), "quat_xyzw", "euler", ValueError, "got 'euler'"),
        (torch.zeros(9), "rotmat", "rotvec", ValueError, r"\(\.\.\., 3, 3\) as rotmat, got \(9,\)"),
        (torch.zeros(2, 4), "rotvec", "rotmat", ValueError, r"\(\.\.\., 3\) as rotvec"),
        (torch.zeros(3, dtype=torch.int64), "rotvec", "rotmat", TypeError, "got torch.int64"),
        (np.zeros(3), "rotvec", "rotmat", TypeError, "got ndarray"),
        (torch.zeros(3), 3, "rotmat", TypeError, "by a string, got 3"),
    ],
)
def test_errors_say_what_was_got(x, src, dst, error, match):
    with pytest.raises(error, match=match):
        convert(x, src, dst)
