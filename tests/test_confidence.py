"""A frame that is believed a tenth pulls a tenth as hard."""

import math

import pytest
import torch
from filters_under_test import ALL
from motions import assert_same_rotation
from test_spectral import swaying

from torchquat import bilateral_filter, gaussian_filter, noise, so3

AT, PUSH = 32, 1e-3  # which frame is pushed, and how far [rad]
NO_SHARES = {
    "repair": "other frames stay as they are",
    "kernel-pca": "poses are compared whole",
    **{
        f"lifting-{name}": "a lifting scheme knows missing frames only"
        for name in ("haar", "linear", "squad", "bezier", "finest", "learned")
    },
}
"""Filters in which a confidence is not a share, and why."""
MEDIANS = ("median", "median-truncate", "hampel")


@pytest.fixture
def noisy(rng):
    return noise.gaussian(swaying(frames=64), 0.1, generator=rng)


def pull(run, q, confidence):
    """How far all other frames move with one frame, over how far it was pushed, ``(T,)``."""
    weight = torch.ones_like(q[..., 0])
    weight[AT, 0] = confidence
    pushed = q.clone()
    step = torch.tensor([PUSH, 0.0, 0.0], dtype=q.dtype)
    pushed[AT, 0] = so3.compose(q[AT, 0], so3.exp(step))
    moved = so3.log(so3.relative(run(q, weight), run(pushed, weight)))[:, 0].norm(dim=-1) / PUSH
    moved[AT] = 0.0
    return moved


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=pytest.mark.xfail(
                name in NO_SHARES,
                reason=NO_SHARES.get(name, ""),
                raises=AssertionError,
                strict=True,
            ),
        )
        for name in ALL
        if name not in MEDIANS
    ],
)
def test_a_tenth_of_the_confidence_pulls_about_a_tenth_as_hard(name, noisy):
    """About: what is believed less also leaves more to the others."""
    whole, half, tenth = (pull(ALL[name], noisy, each).norm() for each in (1.0, 0.5, 0.1))
    assert whole > 0.0
    assert 0.4 < half / whole < 0.65
    assert 0.09 < tenth / whole < 0.26


@pytest.mark.parametrize("name", MEDIANS)
def test_a_median_follows_what_is_believed(name):
    """Not by shares: two against three, who win unless doubted, up to Weiszfeld's last steps."""
    angles = torch.tensor([0.0, 0.0, 0.5, 0.5, 0.5], dtype=torch.float64)[:, None]
    q = so3.exp(torch.stack([angles, torch.zeros_like(angles), torch.zeros_like(angles)], -1))
    doubt = torch.tensor([1.0, 1.0, 0.1, 0.1, 0.1], dtype=torch.float64)[:, None]
    assert_same_rotation(ALL[name](q)[2], q[2], 0.01)
    assert_same_rotation(ALL[name](q, doubt)[2], q[0], 0.01)


@pytest.mark.parametrize("lag", [1, 2, 3])
def test_exactly_where_the_weights_are_known(lag, noisy):
    """By hand: w k / (sum of k - k + w k), for two filters with the same kernel."""
    kernel = [math.exp(-0.5 * (step / 1.5) ** 2) for step in range(-5, 6)]
    own, total = kernel[5 + lag], sum(kernel)
    calm = so3.slerp(noisy[:1].expand(noisy.shape), noisy, 0.1)  # small: the sphere is nearly flat
    for run in (
        lambda q, w: gaussian_filter(q, w, sigma_t=1.5, radius=5),
        lambda q, w: bilateral_filter(q, w, sigma_t=1.5, sigma_g=50.0, radius=5),
    ):
        for confidence in (1.0, 0.1):
            expected = confidence * own / (total - own + confidence * own)
            found = pull(run, calm, confidence)[AT + lag]
            assert found == pytest.approx(expected, rel=0.05)
