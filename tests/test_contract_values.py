"""Odd values in, part A of the contract: every filter ends in a result or in one clear error.

Rows about signs, scale, missing frames and constant motion stand in ``test_contract.py``, those
about single rotations in ``test_so3.py``.
"""

import math

import pytest
import torch
from filters_under_test import APART, every_filter
from motions import (
    BOUND,
    IDENTITY,
    angle_between,
    assert_same_rotation,
    random_rotations,
    smooth_motion,
)
from torch.autograd import gradcheck, gradgradcheck

from torchquat import (
    _blocks,
    bilateral_filter,
    linear_filter,
)
from torchquat.noise import gaussian

GRADIENT = {"eps": 1e-6, "atol": 1e-5, "rtol": 1e-3}


def bilateral(q):
    return bilateral_filter(q, sigma_t=0.8, sigma_g=0.5, radius=1)


@pytest.mark.parametrize("scale", [1.0, -1.0, 2.0, -2.0])
@pytest.mark.parametrize("kernel", ["gaussian", "exponential"])
def test_A1_A2_C7_derivatives_at_identity(scale, kernel):
    """The exponential kernel has a kink at equal neighbours: its first derivatives are finite."""
    q = (scale * IDENTITY).expand(4, 1, 4).clone().requires_grad_()

    def run(q):
        return bilateral_filter(q, sigma_t=0.8, sigma_g=0.5, radius=1, kernel=kernel)

    assert_same_rotation(run(q), IDENTITY.expand(4, 1, 4))
    run(q).cumsum(-1).sum().backward()
    assert q.grad.isfinite().all()
    if kernel == "gaussian":
        assert gradcheck(run, (q,), **GRADIENT)
        assert gradgradcheck(run, (q,), **GRADIENT)


def differences(run, rng, frames=30):
    """A derivative, what differences of values say of it, and the same for the next derivative."""
    q = gaussian(smooth_motion(frames=frames, rng=rng), 0.1, generator=rng).requires_grad_()
    slope, way, way_of_slopes = (
        torch.randn(q.shape, generator=rng, dtype=torch.float64) for _ in range(3)
    )

    def derivative(q):
        return torch.autograd.grad(run(q), q, slope, create_graph=True)[0]

    def difference(of, way):
        there, back = (of((q + step * way).detach().requires_grad_()) for step in (1e-6, -1e-6))
        return (there - back) / 2e-6

    found = derivative(q)
    (second,) = torch.autograd.grad(found, q, way_of_slopes)
    yield (found * way).sum(), (difference(run, way) * slope).sum()
    yield (second * way).sum(), (difference(derivative, way) * way_of_slopes).sum()


@every_filter("derivatives")
def test_C7_derivatives_are_those_of_finite_differences(run, rng):
    (found, expected), _ = differences(run, rng)
    assert found.item() == pytest.approx(expected.item(), rel=1e-5)


@every_filter("second derivatives")
def test_C7_second_derivatives_are_those_of_finite_differences(run, rng):
    _, (found, expected) = differences(run, rng)
    assert found.item() == pytest.approx(expected.item(), rel=1e-4)


def test_C7_first_derivatives_for_second_ones_are_the_same(run, rng):
    """Backward passes of our own are used where no second derivative will be asked for."""
    q = smooth_motion(frames=40, rng=rng).requires_grad_()
    slope = torch.rand(q.shape, generator=rng, dtype=torch.float64)
    alone, recorded = (
        torch.autograd.grad(run(q), q, slope, create_graph=again)[0] for again in (False, True)
    )
    torch.testing.assert_close(alone, recorded, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("frames", [30, 1500])
def test_C7_bandwidths_that_depend_on_the_signal(frames, rng, monkeypatch):
    """What a network makes of the signal, one of them of the other; in one block, in several."""
    monkeypatch.setattr(_blocks, "BLOCK", 2048)

    def run(q):
        wide = 1.0 + q.square().mean()
        narrow = 0.2 * wide + q[..., 0].square().mean()
        weight = 0.1 + q[..., 0].square()
        return bilateral_filter(q, weight, sigma_t=wide, sigma_g=narrow, radius=2)

    (found, expected), (second, expected_second) = differences(run, rng, frames)
    assert found.item() == pytest.approx(expected.item(), rel=1e-5)
    assert second.item() == pytest.approx(expected_second.item(), rel=1e-4)
    q = smooth_motion(frames=frames, rng=rng).requires_grad_()
    alone, recorded = (
        torch.autograd.grad(run(q).cumsum(-1).sum(), q, create_graph=c)[0] for c in (False, True)
    )
    torch.testing.assert_close(alone, recorded, rtol=1e-7, atol=1e-9)


def test_A5_opposite_neighbours(run, rng):
    q = random_rotations(1, 3, rng=rng)
    pair = torch.cat([q, -q]).requires_grad_()
    assert_same_rotation(run(pair), pair)
    run(pair).cumsum(-1).sum().backward()
    assert pair.grad.isfinite().all()


@pytest.mark.parametrize("w", [0.0, -0.0])
def test_A8_half_turns_between_neighbours(w, run, dtype):
    """Both ways round are equally short: either is a result, NaN is none."""
    q = IDENTITY.to(dtype).expand(6, 3, 4).clone()
    q[3:] = torch.tensor([0.6, 0.0, 0.8, w], dtype=dtype)
    q.requires_grad_()
    result = run(q)
    result.cumsum(-1).sum().backward()
    assert result.isfinite().all() and q.grad.isfinite().all()


@pytest.mark.parametrize("off", [1e-2, 2e-3])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_A9_derivatives_near_half_turns(off, side):
    half = (math.pi + side * off) / 2
    turn = torch.tensor([0.6 * math.sin(half), 0.0, 0.8 * math.sin(half), math.cos(half)])
    q = torch.stack([IDENTITY, turn.double(), IDENTITY])[:, None].requires_grad_()
    assert gradcheck(bilateral, (q,), **GRADIENT)


@pytest.mark.parametrize("norm", [1e-30, 1e30])
def test_A12_norms_of_any_size(norm, run, rng, dtype):
    q = smooth_motion(rng=rng)
    assert_same_rotation(run((q * norm).to(dtype)), run(q.to(dtype)))


def test_A12_half_precision_at_its_end(run, rng):
    q = smooth_motion(rng=rng, dtype=torch.float16)
    assert_same_rotation(run(q / q.abs().amax(-1, keepdim=True) * 6e4), run(q))


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("where", ["first", "last", "half"])
def test_A15_A16_gaps_at_the_ends_are_held(bad, where, run, rng):
    q = smooth_motion(frames=12, rng=rng)
    missing = {"first": slice(0, 1), "last": slice(11, 12), "half": slice(0, 6)}[where]
    present = {"first": slice(1, 12), "last": slice(0, 11), "half": slice(6, 12)}[where]
    q[missing, 1] = bad
    result = run(q)
    assert result.isfinite().all()
    # as near to the held frame as the filter's window lets neighbours pull it
    nearest = q[present, 1][0 if where != "last" else -1]
    assert angle_between(result[missing, 1], nearest).max() < 0.8


def test_A17_A18_whole_joints_and_items_missing(run, rng):
    q = smooth_motion(2, rng=rng)
    spoiled = q.clone()
    spoiled[0, :, 1] = torch.nan
    result = run(spoiled)
    assert torch.equal(result[1], run(q)[1])
    if run in APART.values():
        assert torch.equal(result[0, :, [0, 2]], run(q)[0, :, [0, 2]])
    assert torch.equal(result[0, :, 1], IDENTITY.expand(20, 4))
    assert run(torch.full_like(q, torch.nan)).isfinite().all()


def test_A20_all_directions_equally_likely(run):
    """Half turns about all axes: nothing tells where the mean lies, yet gradients are finite."""
    q = torch.eye(4).double()[:, None].repeat(2, 3, 1).requires_grad_()
    result = run(q)
    result.cumsum(-1).sum().backward()
    assert result.isfinite().all() and q.grad.isfinite().all()


def test_A21_rounding_noise_is_not_amplified(run, rng, dtype):
    q = random_rotations(1, 3, rng=rng).expand(30, 3, 4)
    q = (q + 2 * torch.finfo(dtype).eps * torch.randn(30, 3, 4, generator=rng).double()).to(dtype)
    steps = [angle_between(each[1:], each[:-1]).max() for each in (q, run(q))]
    assert steps[1] <= steps[0] + BOUND[dtype]


def test_A22_largest_finite_components(run, rng, dtype):
    q = smooth_motion(rng=rng, dtype=dtype)
    q[4] = torch.finfo(dtype).max
    q[5, :, :2] = torch.finfo(dtype).max
    assert run(q).isfinite().all()


@pytest.mark.parametrize(
    ("dtype", "size"),
    [
        (torch.float32, 1e-40),
        (torch.float32, 1e38),
        (torch.float64, 1e-311),
        (torch.float64, 1e300),
    ],
)
def test_B15_weights_of_any_size(run, dtype, size, rng):
    """Too small to divide by is missing; too large to multiply is cut."""
    q = smooth_motion(frames=12, rng=rng, dtype=dtype)
    weight = size * torch.rand(12, 3, generator=rng, dtype=dtype)
    assert run(q, weight).isfinite().all()
    weight[3:9] = 1.0
    assert run(q, weight).isfinite().all()


@pytest.mark.parametrize("small", [-2e-311, 5e-324, 1e-300])
def test_A23_masks_with_entries_too_small_to_divide_by(small, rng):
    q = smooth_motion(frames=12, rng=rng)
    mask = torch.tensor([small, 1.0, small], dtype=torch.float64)
    assert_same_rotation(linear_filter(q, mask=mask), q, 1e-9)
    weight = (torch.arange(12) != 5).double()[:, None]
    assert linear_filter(q, weight, mask=mask).isfinite().all()
