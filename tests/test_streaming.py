"""Filters fed frame by frame: what comes out is what they make of the whole sequence."""

import copy

import filters_under_test as filters
import pytest
import torch
from motions import assert_same_rotation
from streams import ONLINE, noisy, streamed, with_gaps

from torchquat import (
    GaussianFilter,
    HampelFilter,
    KalmanSmoother,
    LinearFilter,
    OneEuroFilter,
    SavitzkyGolayFilter,
    Stream,
)

online = pytest.mark.parametrize(("run", "latency"), ONLINE.values(), ids=ONLINE)


def known_soon(known, run, latency):
    """Which frames are there, or have the next one within the latency of the first pass."""
    soon = known.clone()
    if latency == 0:
        causal = getattr(run, "causal", True) or isinstance(run, OneEuroFilter)
        return torch.ones_like(known) if causal else known
    for lag in range(1, latency // getattr(run, "iterations", 1) + 1):
        soon[:-lag] |= known[lag:]
    return soon


@online
def test_equals_the_offline_result(run, latency, rng, dtype):
    """At the ends too, and within 1e-6 rad in single precision."""
    q = noisy(rng=rng, frames=70 if latency > 20 else 24, dtype=dtype)
    tol = 5e-6 if getattr(run, "chart", "") == "global" else 1e-6  # near half turns
    assert Stream(run).latency == latency
    assert_same_rotation(streamed(run, q), run(q), tol if dtype == torch.float32 else 1e-12)
    # bandwidths that are no numbers of single precision
    precise = copy.deepcopy(run).double()
    assert_same_rotation(streamed(precise, q.double()), precise(q.double()), 1e-12)


@online
def test_missing_frames_take_no_part(run, latency, rng):
    q, weight = with_gaps(noisy(rng=rng, frames=70 if latency > 20 else 24), rng)
    expected, result = run(q, weight), streamed(run, q, weight)
    known = torch.isfinite(q).all(-1) & (weight > 0)
    assert result.isfinite().all()
    # the Hampel filter cleans the frames that a gap is filled between: one further than it sees
    same = known if isinstance(run, HampelFilter) else known_soon(known, run, latency)
    assert_same_rotation(result[same], expected[same], 1e-12)


@online
def test_a_gap_just_before_the_end(run, latency, rng):
    """The last frame is there: the gap ends in every window that is still to come."""
    frames = 70 if latency > 20 else 24
    q, weight = noisy(rng=rng, frames=frames), torch.ones(frames, 1, dtype=torch.float64)
    weight[-max(latency, 2) - 3 : -1] = 0.0
    expected, result = run(q, weight), streamed(run, q, weight)
    soon = known_soon(weight[:, 0] > 0, run, latency)
    assert_same_rotation(result[soon], expected[soon], 1e-12)


@pytest.mark.parametrize("frames", [1, 2, 7])
@online
def test_sequences_shorter_than_the_window(run, latency, frames, rng):
    q = noisy(2, rng=rng, frames=frames)
    assert_same_rotation(streamed(run, q), run(q), 1e-12)


@pytest.mark.parametrize("order", [2, 3])
def test_kalman_gives_the_forward_pass(order, rng):
    """The estimate of the last of all frames so far, which the backward pass does not change."""
    run = KalmanSmoother([0.1, 0.2, 0.3], 0.3, order=order)
    q, weight = with_gaps(noisy(rng=rng, frames=14), rng)
    weight[1:4, 0] = 0.0
    for given in (None, weight):
        so_far = [run(q[: t + 1], None if given is None else given[: t + 1])[t] for t in range(14)]
        assert_same_rotation(streamed(run, q, given), torch.stack(so_far), 1e-7)  # 1e7 is "unknown"


def test_savitzky_golay_starts_as_if_held(rng):
    """Its fit to the first whole window is further ahead than the latency; the last is not."""
    run, held = SavitzkyGolayFilter(3, 2), SavitzkyGolayFilter(3, 2, boundary="replicate")
    q = noisy(rng=rng)
    result = streamed(run, q)
    assert_same_rotation(result[3:], run(q)[3:], 1e-12)
    assert_same_rotation(result[:3], held(q)[:3], 1e-12)


def test_long_gaps_hold_the_last_frame_and_then_end(rng):
    q = noisy(rng=rng)
    weight = torch.ones_like(q[..., 0])
    weight[10:30, 1] = 0.0
    run = GaussianFilter(0.5, radius=2)
    result, expected = streamed(run, q, weight), run(q, weight)
    known = weight > 0
    known[28:30] = True  # the next present frame is in the window
    assert_same_rotation(result[known], expected[known], 1e-12)
    assert_same_rotation(result[12:28, 1], q[9:10, 1].expand(16, 4), 1e-12)


@pytest.mark.parametrize("name", ["bilateral-never", "gaussian-alone"])
def test_what_sees_its_own_frame_only_holds_the_last_one(name, rng):
    q, weight = noisy(rng=rng, frames=9), torch.ones(9, 1, dtype=torch.float64)
    weight[3:6] = 0.0
    result = streamed(ONLINE[name][0], q, weight)
    assert_same_rotation(result, q[[0, 1, 2, 2, 2, 2, 6, 7, 8]], 1e-12)


def test_joints_that_nobody_has_seen_yet(rng):
    q = noisy(rng=rng)
    q[:25, 0] = torch.nan
    result, run = streamed(ONLINE["bilateral"][0], q), ONLINE["bilateral"][0]
    assert_same_rotation(result[25:], run(q)[25:], 1e-12)
    assert_same_rotation(result[:, 1:], run(q)[:, 1:], 1e-12)
    assert result.isfinite().all()
    causal = OneEuroFilter(0.05, 0.2)
    assert_same_rotation(streamed(causal, q)[25:], causal(q)[25:], 1e-12)


@pytest.mark.parametrize("name", ["bilateral", "median", "nonlocal-causal", "one-euro"])
def test_results_lie_in_the_hemispheres_of_the_frames(name, rng):
    q, weight = with_gaps(noisy(rng=rng), rng)
    q = torch.where(torch.isfinite(q), q, 1.0)
    result = streamed(ONLINE[name][0], q, weight)
    assert ((result * q).sum(-1) >= 0).all()


@pytest.mark.parametrize("name", ["bilateral", "nonlocal-pose", "hampel", "one-euro"])
def test_a_batch_is_as_many_streams(name, rng):
    q = noisy(3, rng=rng, frames=16)
    run = ONLINE[name][0]
    alone = torch.stack([streamed(run, each) for each in q])
    assert_same_rotation(streamed(run, q), alone, 1e-12)


def test_a_mask_as_weight_and_one_weight_for_all(rng):
    q = noisy(rng=rng)
    run = LinearFilter([1.0, 2.0, 1.0])
    mask = torch.rand(40, 3, generator=rng) < 0.8
    mask[0] = True
    assert_same_rotation(streamed(run, q, mask)[mask], run(q, mask)[mask], 1e-12)
    some = torch.rand(40, 1, generator=rng, dtype=q.dtype)
    assert_same_rotation(streamed(run, q, some), run(q, some), 1e-12)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", [*ONLINE, "kalman"])
def test_on_a_gpu(name, rng):
    run = copy.deepcopy(filters.ALL[name] if name == "kalman" else ONLINE[name][0]).double()
    q, weight = with_gaps(noisy(2, rng=rng, frames=75), rng)
    expected = streamed(run, q, weight)
    result = streamed(run.to("cuda"), q.cuda(), weight.cuda())
    assert_same_rotation(result.cpu(), expected, 1e-9)
