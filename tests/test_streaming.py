"""Filters fed frame by frame: what comes out is what they make of the whole sequence."""

import copy
import dataclasses
import re

import filters_under_test as filters
import pytest
import torch
from motions import angle_between, assert_same_rotation, random_rotations, smooth_motion
from torch.utils._python_dispatch import TorchDispatchMode

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    HampelFilter,
    KalmanSmoother,
    LinearFilter,
    NonLocalPoseMeans,
    OneEuroFilter,
    RepresentationAdapter,
    SavitzkyGolayFilter,
    Stream,
    so3,
)

# A new filter joins here or in REFUSED by one line: what it is in filters_under_test, its latency.
LATENCY = {
    "gaussian": 5,
    "gaussian-truncate": 5,
    "gaussian-causal": 0,
    "linear": 2,
    "linear-causal": 0,
    "linear-asymmetric": 2,
    "bilateral": 10,
    "bilateral-exponential": 5,
    "bilateral-per-joint": 6,
    "bilateral-causal": 0,
    "nonlocal-joint": 5,
    "nonlocal-pose": 5,
    "nonlocal-causal": 0,
    "savitzky-golay-reflect": 2,
    "moving-mean": 2,
    "butterworth": 21,
    "butterworth-extrapolate": 32,
    "median": 2,
    "median-truncate": 1,
    "hampel": 2,
    "one-euro": 0,
}
ONLINE = {name: (filters.ALL[name], latency) for name, latency in LATENCY.items()} | {
    "nonlocal-global": (NonLocalPoseMeans(0.3, patch_radius=1, search_radius=2, chart="global"), 3),
    "nonlocal-groups": (NonLocalPoseMeans(0.3, patch_radius=2, groups=[0, 1, 0], causal=True), 0),
    "bilateral-replicate": (BilateralFilter(1.0, 0.5, boundary="replicate", causal=True), 0),
    "bilateral-thrice": (BilateralFilter(0.6, 0.5, iterations=3, boundary="truncate"), 6),
    "bilateral-never": (BilateralFilter(0.6, 0.5, iterations=0), 0),
    "gaussian-alone": (GaussianFilter(1.0, radius=0), 0),
}
OTHERWISE = {"kalman", "kalman-acceleration", "savitzky-golay"}  # equal to something else
REFUSED = {
    "auto": "estimates the noise from the whole sequence",
    "kernel-pca": "learns poses from the whole sequence",
    "lifting-haar": "thresholds come from the whole sequence",
    "local-spectrum": "estimates the noise from the whole sequence",
    "low-rank": "learns trajectories from the whole sequence",
    "principal-components": "learns poses from the whole sequence",
    "repair": "judges samples by the whole sequence",
}
online = pytest.mark.parametrize(("run", "latency"), ONLINE.values(), ids=ONLINE)


def noisy(*batch, rng, frames=40, dtype=torch.float64):
    """Motion with noise, signs and norms at random."""
    q = smooth_motion(*batch, frames=frames, rng=rng, dtype=dtype)
    q = so3.turn(q, 0.15 * torch.randn(*q.shape[:-1], 3, generator=rng, dtype=dtype))
    return q * (2.0 * torch.randn(*q.shape[:-1], 1, generator=rng, dtype=dtype).sign())


def with_gaps(q, rng):
    """Some samples not a number, others of weight 0; the first and the last frame are whole."""
    weight = 0.2 + torch.rand(q.shape[:-1], generator=rng, dtype=q.dtype)
    lost = torch.rand(q.shape[:-1], generator=rng) < 0.1
    weight[torch.rand(q.shape[:-1], generator=rng) < 0.1] = 0.0
    weight[..., [0, -1], :], lost[..., [0, -1], :] = 1.0, False
    return torch.where(lost[..., None], torch.nan, q), weight


def known_soon(known, run, latency):
    """Which frames are there, or have the next one within the latency of the first pass."""
    soon = known.clone()
    if latency == 0:
        causal = getattr(run, "causal", True) or isinstance(run, OneEuroFilter)
        return torch.ones_like(known) if causal else known
    for lag in range(1, latency // getattr(run, "iterations", 1) + 1):
        soon[:-lag] |= known[lag:]
    return soon


def streamed(run, q, weight=None):
    """All frames ``(..., T, J, 4)``, pushed one by one."""
    stream = Stream(run)
    out = []
    for t in range(q.shape[-3]):
        out.append(stream.push(q[..., t, :, :], None if weight is None else weight[..., t, :]))
    rest = stream.flush()
    held_back = min(stream.latency, q.shape[-3])
    assert [x is None for x in out] == [t < held_back for t in range(q.shape[-3])]
    out = torch.stack([x for x in out if x is not None] or [q[..., 0, :, :]], -3)
    return torch.cat([out[..., : q.shape[-3] - held_back, :, :], rest], -3)


def tensors_of(state):
    """Every tensor that a state holds."""
    if isinstance(state, list):
        return [x for each in state for x in tensors_of(each)]
    if dataclasses.is_dataclass(state):
        fields = dataclasses.fields(state)
        return [x for each in fields for x in tensors_of(getattr(state, each.name))]
    assert isinstance(state, torch.Tensor)
    return [state]


@online
def test_equals_the_offline_result(run, latency, rng, dtype):
    """At the ends too, and within 1e-6 rad in single precision."""
    q = noisy(rng=rng, frames=75 if latency > 20 else 40, dtype=dtype)
    tol = 5e-6 if getattr(run, "chart", "") == "global" else 1e-6  # near half turns
    assert Stream(run).latency == latency
    assert_same_rotation(streamed(run, q), run(q), tol if dtype == torch.float32 else 1e-12)


@online
def test_missing_frames_take_no_part(run, latency, rng):
    q, weight = with_gaps(noisy(rng=rng, frames=75 if latency > 20 else 40), rng)
    expected, result = run(q, weight), streamed(run, q, weight)
    known = torch.isfinite(q).all(-1) & (weight > 0)
    assert result.isfinite().all()
    # the Hampel filter cleans the frames that a gap is filled between: one further than it sees
    same = known if isinstance(run, HampelFilter) else known_soon(known, run, latency)
    assert_same_rotation(result[same], expected[same], 1e-12)


@pytest.mark.parametrize("frames", [1, 2, 3, 7])
@online
def test_sequences_shorter_than_the_window(run, latency, frames, rng):
    q = noisy(2, rng=rng, frames=frames)
    assert_same_rotation(streamed(run, q), run(q), 1e-12)


@pytest.mark.parametrize("order", [2, 3])
def test_kalman_gives_the_forward_pass(order, rng):
    """The estimate of the last of all frames so far, which the backward pass does not change."""
    run = KalmanSmoother([0.1, 0.2, 0.3], 0.3, order=order)
    q, weight = with_gaps(noisy(rng=rng, frames=25), rng)
    weight[1:4, 0] = 0.0
    for given in (None, weight):
        so_far = [run(q[: t + 1], None if given is None else given[: t + 1])[t] for t in range(25)]
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
    q = noisy(2, 3, rng=rng, frames=24)
    run = ONLINE[name][0]
    alone = torch.stack([streamed(run, each) for each in q.flatten(0, 1)]).reshape(q.shape)
    assert_same_rotation(streamed(run, q), alone, 1e-12)


@pytest.mark.parametrize("name", [*ONLINE, "kalman"])
def test_starting_one_person_anew_leaves_the_others_alone(name, rng):
    run = filters.ALL[name] if name == "kalman" else ONLINE[name][0]
    q = noisy(3, rng=rng, frames=30)
    kept, disturbed, fresh = Stream(run), Stream(run), Stream(run)
    others = torch.tensor([True, False, True])
    for t in range(30):
        if t == 11:
            disturbed.reset(1)
        expected, found = kept.push(q[:, t]), disturbed.push(q[:, t])
        own = fresh.push(q[1, t]) if t >= 11 else None
        if expected is not None:
            assert torch.equal(found[others], expected[others])
        if own is not None:
            assert_same_rotation(found[1], own, 1e-12)
        elif t >= 11 and found is not None:
            assert found[1].isnan().all()
    rest, whole, own = disturbed.flush(), kept.flush(), fresh.flush()
    assert torch.equal(rest[others], whole[others])
    due = own.shape[-3]
    late = rest.shape[-3] - due
    assert rest[1, :late].isnan().all()
    assert_same_rotation(rest[1, late:], own, 1e-12)


def test_people_are_chosen_by_index_or_mask(rng):
    q = noisy(2, 2, rng=rng, frames=3)
    for people in (torch.tensor([[False, True], [False, False]]), (0, 1)):
        stream = Stream(GaussianFilter(1.0))
        stream.push(q[..., 0, :, :])
        stream.reset(people)
        assert stream.state.age.tolist() == [1, 0, 1, 1]
    with pytest.raises(IndexError):
        stream.reset(2)
    stream.reset()
    assert stream.state is None and stream.flush() is None


def test_streams_of_other_shapes_after_a_flush(rng):
    stream = Stream(GaussianFilter(1.0))
    for shape in ((3, 4), (2, 5, 4), (0, 5, 4), (2, 0, 4)):
        for _ in range(5):
            out = stream.push(random_rotations(*shape[:-1], rng=rng))
        assert out.shape == shape
        assert stream.flush().shape == (*shape[:-2], 3, *shape[-2:])


@pytest.mark.parametrize("name", ["bilateral", "one-euro", "kalman"])
def test_the_state_is_tensors_that_do_not_grow(name, rng):
    run = filters.ALL[name]
    q = noisy(2, rng=rng, frames=60)
    stream, sizes = Stream(run), []
    for t in range(60):
        stream.push(q[:, t])
        sizes.append([x.shape for x in tensors_of(stream.state)])
        assert all(
            x._base is None or x._base.numel() <= 2 * x.numel()
            for x in tensors_of(stream.state)
            if x.numel()
        )
    assert all(each == sizes[0] for each in sizes)


@pytest.mark.parametrize("name", ["bilateral", "one-euro", "kalman"])
def test_the_state_can_be_kept_and_set_again(name, rng):
    run = filters.ALL[name]
    q, weight = with_gaps(noisy(2, rng=rng), rng)
    stream, copied = Stream(run), Stream(run)
    for t in range(25):
        stream.push(q[:, t], weight[:, t])
    copied.state = copy.deepcopy(stream.state)
    for t in range(25, 40):
        expected, found = (s.push(q[:, t], weight[:, t]) for s in (stream, copied))
        assert_same_rotation(found, expected, 1e-12)
    assert torch.equal(copied.flush(), stream.flush())


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_single(half, rng):
    q = noisy(rng=rng).to(half)
    result = streamed(BilateralFilter(1.0, 0.5), q)
    assert result.dtype == half
    assert angle_between(result, BilateralFilter(1.0, 0.5)(q)).max() < 0.05


def test_results_are_plain_tensors_without_gradients(rng):
    """And the frames' memory may be used again."""
    q = noisy(rng=rng)
    stream, buffer, out = Stream(GaussianFilter(1.0, learnable=True)), q[0].clone(), []
    for t in range(40):
        buffer.copy_(q[t])
        out.append(stream.push(buffer.clone().requires_grad_() if t % 2 else buffer))
    result = torch.stack(out[3:])
    assert not result.requires_grad and not result.is_inference()
    assert_same_rotation(result, GaussianFilter(1.0)(q)[:-3], 1e-12)
    assert (torch.ones((), dtype=q.dtype, requires_grad=True) * stream.flush()).requires_grad


@pytest.mark.parametrize(
    ("name", "calls"),
    [
        ("gaussian", 85),
        ("bilateral-causal", 190),
        ("nonlocal-pose", 120),
        ("one-euro", 85),
        ("kalman", 115),
        ("median", 500),
    ],
)
def test_a_frame_takes_few_calls(name, calls, rng):
    """Of about 4 microseconds each, whatever the machine's mood: half a millisecond is 125."""

    class Counter(TorchDispatchMode):
        count = 0

        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            self.count += 1
            return func(*args, **(kwargs or {}))

    q = noisy(rng=rng)
    stream = Stream(filters.ALL[name])
    for frame in q:
        stream.push(frame)
    with Counter() as counter:
        stream.push(q[0])
    assert counter.count <= calls


@pytest.mark.parametrize(("name", "why"), REFUSED.items(), ids=REFUSED)
def test_filters_of_whole_sequences_are_refused(name, why):
    with pytest.raises(TypeError, match=rf"^filter must see a window .*, got \w+, .*{why}\.$"):
        Stream(filters.ALL[name])


def test_every_filter_is_streamed_or_refused():
    kinds = {type(filters.ALL[name]) for name in {*LATENCY, *OTHERWISE, *REFUSED}}
    assert kinds == {type(run) for run in filters.ALL.values()}


@pytest.mark.parametrize(
    ("run", "error", "message"),
    [
        (GaussianFilter(1.0, boundary="circular"), ValueError, "boundary must .*got 'circular'"),
        (NonLocalPoseMeans(embedding=torch.nn.Identity()), ValueError, "embedding .*got Identity"),
        (RepresentationAdapter(GaussianFilter(), "rotvec"), TypeError, "got RepresentationAdapter"),
        (torch.nn.Identity(), TypeError, "got Identity, whose window is not known"),
        (lambda q: q, TypeError, "got function"),
    ],
)
def test_what_cannot_be_streamed_says_why(run, error, message):
    with pytest.raises(error, match=message):
        Stream(run)


@pytest.mark.parametrize(
    ("frame", "weight", "error", "message"),
    [
        ([1.0], None, TypeError, "frame must be a torch.Tensor, got list."),
        (torch.ones(3, 4, dtype=torch.int64), None, TypeError, "floating-point tensor, got"),
        (torch.ones(4), None, ValueError, "frame must have shape (..., J, 4), got (4,)."),
        (torch.ones(3, 3), None, ValueError, "frame must have shape (..., J, 4), got (3, 3)."),
        (torch.ones(2, 4), None, ValueError, "must be (3, 4) of torch.float32 on cpu as before"),
        (torch.ones(3, 4).double(), None, ValueError, "got (3, 4) of torch.float64 on cpu."),
        (torch.ones(3, 4), torch.ones(2), ValueError, "broadcast to (..., J) = (3,), got (2,)."),
        (torch.ones(3, 4), torch.ones(3).double(), TypeError, "or torch.float32 as frame, got"),
    ],
)
def test_wrong_frames(frame, weight, error, message):
    stream = Stream(GaussianFilter(1.0))
    stream.push(torch.ones(3, 4))
    with pytest.raises(error, match=re.escape(message)):
        stream.push(frame, weight)
    assert stream.state.age.tolist() == [1]


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
    run = copy.deepcopy(filters.ALL[name] if name == "kalman" else ONLINE[name][0])
    q, weight = with_gaps(noisy(2, rng=rng, frames=75), rng)
    expected = streamed(run, q, weight)
    result = streamed(run.to("cuda"), q.cuda(), weight.cuda())
    assert_same_rotation(result.cpu(), expected, 1e-9)


def test_docs_say_what_it_is():
    text = " ".join(Stream.__doc__.split())
    for promise in ("latency", "forward pass", "does not grow", "no gradients", "refused"):
        assert promise in text
