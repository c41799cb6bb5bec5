"""The operations with backward passes of their own: right, at every angle, once and twice."""

from functools import partial

import pytest
import torch

from torchquat import (
    _blocks,
    _operations,
    bilateral_filter,
    gaussian_filter,
    linear_filter,
    nonlocal_pose_means,
    so3,
)

ANGLES = [0.0, 1e-9, 1e-4, 0.3, 1.5, 3.0, 3.1]


def pair(angle, rng, flip=False):
    """Two quaternions so far apart, components as planes of one number each."""
    a = so3.normalize(torch.randn(4, generator=rng, dtype=torch.float64))
    axis = torch.nn.functional.normalize(torch.randn(3, generator=rng, dtype=torch.float64), dim=0)
    b = so3.compose(a, so3.exp(angle * axis))
    return a, -b if flip else b, angle * axis


def planes(*tensors):
    return [x.clone().requires_grad_() for tensor in tensors for x in tensor.unbind(-1)]


def unit(*parts):
    return _operations.normalized(parts)


OPERATIONS = {
    "between": lambda *p: _operations.between(unit(*p[:4]), unit(*p[4:])),
    "squared_angle": lambda *p: _operations.squared_angle(unit(*p[:4]), unit(*p[4:])),
    "apart": lambda *p: _operations.apart(unit(*p[:4]), unit(*p[4:])),
}


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize(
    ("name", "flip"),
    [
        ("between", False),  # which takes neighbours of one hemisphere
        ("squared_angle", False),
        ("squared_angle", True),
        ("apart", False),
        ("apart", True),
    ],
)
def test_gradients_of_pairs(name, flip, angle, rng):
    a, b, _ = pair(angle, rng, flip)
    inputs = planes(a, b)
    assert torch.autograd.gradcheck(OPERATIONS[name], inputs)
    assert torch.autograd.gradgradcheck(OPERATIONS[name], inputs)


@pytest.mark.parametrize("angle", [*ANGLES, 4.0, 6.0, 10.0])
def test_gradients_of_a_turn(angle, rng):
    """Also over half turns, where the other sign of the result is taken."""
    a, _, v = pair(angle, rng)
    inputs = planes(a, v)
    assert torch.autograd.gradcheck(lambda *p: _operations.turned(p[:4], p[4:]), inputs)
    assert torch.autograd.gradgradcheck(lambda *p: _operations.turned(p[:4], p[4:]), inputs)


def test_gradients_of_weighted_vectors(rng):
    """A weight for each row, one for a column, and none that needs a gradient."""
    v = torch.randn(3, 5, 2, generator=rng, dtype=torch.float64, requires_grad=True)
    total = torch.randn(3, 5, 2, generator=rng, dtype=torch.float64, requires_grad=True)

    def add(m, v, total, sign):
        return _operations.accumulated(total.unbind(0), m, v.unbind(0), sign)

    for shape in ((5, 2), (5, 1), (2,)):
        m = torch.rand(*shape, generator=rng, dtype=torch.float64, requires_grad=True)
        for sign in (1, -1):
            assert torch.autograd.gradcheck(partial(add, sign=sign), (m, v, total))
            assert torch.autograd.gradgradcheck(partial(add, sign=sign), (m, v, total))


@pytest.mark.parametrize("name", [*OPERATIONS, "turned"])
def test_float32_gradients_keep_their_digits_at_small_angles(name, rng):
    """What cancels near 0 must not be seen: against the same in float64."""
    for angle in (0.0, 1e-7, 1e-5, 1e-3, 1e-2, 0.1):
        a, b, v = pair(angle, rng)
        found = []
        for dtype in (torch.float32, torch.float64):
            inputs = planes(a.to(dtype), (v if name == "turned" else b).to(dtype))
            if name == "turned":
                outputs = _operations.turned(unit(*inputs[:4]), inputs[4:])
            else:
                outputs = OPERATIONS[name](*inputs)
            outputs = [outputs] if isinstance(outputs, torch.Tensor) else outputs
            total = sum((k + 1) * y for k, y in enumerate(outputs))
            found.append(torch.stack(torch.autograd.grad(total, inputs)))
        assert (found[0].double() - found[1]).abs().max() < 5e-6, angle


FILTERS = {
    "bilateral": lambda q, w, s: bilateral_filter(q, w, sigma_t=1.0 + s, sigma_g=0.5 * s, radius=2),
    "gaussian": lambda q, w, s: gaussian_filter(q, w, sigma_t=s, radius=2),
    "linear": lambda q, w, s: linear_filter(q, w, mask=torch.stack([-0.2 * s, s, 0.4 * s])),
    "non-local": lambda q, w, s: nonlocal_pose_means(
        q, w, sigma=s, patch_radius=1, search_radius=2
    ),
}


@pytest.mark.parametrize("weighted", [False, True], ids=["whole", "weighted"])
@pytest.mark.parametrize("name", FILTERS)
def test_blocks_made_again_have_the_same_gradients(name, weighted, rng, monkeypatch):
    """First and second derivatives, of the signal, its weights and the bandwidth."""
    q = torch.randn(2, 40, 2, 4, generator=rng, dtype=torch.float64, requires_grad=True)
    w = torch.rand(2, 40, 2, generator=rng, dtype=torch.float64) + 0.1
    s = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)
    w.requires_grad_(weighted)
    inputs = [q, w, s] if weighted else [q, s]
    slope = torch.randn(q.shape, generator=rng, dtype=torch.float64)

    def derivatives():
        result = FILTERS[name](q, w if weighted else None, s)
        first = torch.autograd.grad(result, inputs, slope, create_graph=True)
        curve = sum((g * g.detach().sin()).sum() for g in first)
        return result, *first, *torch.autograd.grad(curve, inputs, retain_graph=True)

    expected = derivatives()
    plain = torch.autograd.grad(FILTERS[name](q, w if weighted else None, s), inputs, slope)
    monkeypatch.setattr(_blocks, "BLOCK", 16)
    assert sum(len(times) for _, times in _blocks.blocks(q, 2)) > 2
    actual = derivatives()
    again = torch.autograd.grad(FILTERS[name](q, w if weighted else None, s), inputs, slope)
    for one, other in zip((*actual, *again), (*expected, *plain), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-11)


def test_memory_of_backward_does_not_grow_with_the_window(rng, monkeypatch):
    """What is kept for the backward pass: tensors of the size of the signal, however many lags."""
    monkeypatch.setattr(_blocks, "BLOCK", 2048)
    q = torch.randn(4000, 4, 4, generator=rng, requires_grad=True)

    def kept(radius):
        sizes = {}

        def note(x):
            sizes[x.untyped_storage().data_ptr()] = x.untyped_storage().nbytes() // x.itemsize
            return x

        with torch.autograd.graph.saved_tensors_hooks(note, lambda x: x):
            result = bilateral_filter(q, sigma_t=3.0, sigma_g=0.5, radius=radius)
        assert result.requires_grad
        return sum(sizes.values())

    assert kept(12) < 1.1 * kept(2)
    assert kept(12) < 4 * q.numel()
