"""Streams in use: people, states, costs, and what is refused."""

import copy
import dataclasses
import re

import filters_under_test as filters
import pytest
import torch
from motions import angle_between, assert_same_rotation, random_rotations
from streams import LATENCY, ONLINE, noisy, streamed, with_gaps
from torch.overrides import TorchFunctionMode

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    NonLocalPoseMeans,
    RepresentationAdapter,
    Stream,
)

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


def tensors_of(state):
    """Every tensor that a state holds."""
    if isinstance(state, list):
        return [x for each in state for x in tensors_of(each)]
    if dataclasses.is_dataclass(state):
        fields = dataclasses.fields(state)
        return [x for each in fields for x in tensors_of(getattr(state, each.name))]
    return [state] if isinstance(state, torch.Tensor) else []


@pytest.mark.parametrize(
    "name", [name for name in (*ONLINE, "kalman") if "butterworth" not in name]
)
def test_starting_one_person_anew_leaves_the_others_alone(name, rng):
    run = filters.ALL[name] if name == "kalman" else ONLINE[name][0]
    q = noisy(3, rng=rng, frames=20)
    kept, disturbed, fresh = Stream(run), Stream(run), Stream(run)
    others = torch.tensor([True, False, True])
    for t in range(20):
        if t == 7:
            disturbed.reset(1)
        expected, found = kept.push(q[:, t]), disturbed.push(q[:, t])
        own = fresh.push(q[1, t]) if t >= 7 else None
        if expected is not None:
            assert torch.equal(found[others], expected[others])
        if own is not None:
            assert_same_rotation(found[1], own, 1e-12)
        elif t >= 7 and found is not None:
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


def test_a_state_knows_how_frames_were_laid_out(rng):
    q = noisy(2, 3, rng=rng, frames=8).half()
    stream, copied = Stream(BilateralFilter(1.0, 0.5)), Stream(BilateralFilter(1.0, 0.5))
    for t in range(8):
        stream.push(q[..., t, :, :])
    copied.state = copy.deepcopy(stream.state)
    for each in (stream, copied):
        each.reset((0, 1))
    expected, found = stream.flush(), copied.flush()
    assert found.dtype == torch.float16 and found.shape == expected.shape
    assert torch.equal(found.nan_to_num(7.0), expected.nan_to_num(7.0))
    copied.state = None
    copied.push(q[0, ..., 0, :, :])


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
    assert not result.requires_grad and not any(each.is_inference() for each in out[3:])
    assert_same_rotation(result, GaussianFilter(1.0)(q)[:-3], 1e-12)
    assert (torch.ones((), dtype=q.dtype, requires_grad=True) * stream.flush()).requires_grad


@pytest.mark.parametrize(
    ("name", "calls"),
    [
        ("gaussian", 105),
        ("bilateral-causal", 225),
        ("nonlocal-pose", 125),
        ("one-euro", 110),
        ("kalman", 140),
        ("median", 515),
    ],
)
def test_a_frame_takes_few_calls(name, calls, rng):
    """Calls are what a frame costs, about 4 microseconds each; time itself varies too much."""

    class Counter(TorchFunctionMode):
        count = 0

        def __torch_function__(self, func, types, args=(), kwargs=None):
            self.count += 1
            return func(*args, **(kwargs or {}))

    q = noisy(rng=rng)
    stream = Stream(filters.ALL[name])
    for frame in q:
        stream.push(frame)
    with Counter() as counter:
        stream.push(q[0])
    assert counter.count <= calls, counter.count


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


def test_docs_say_what_it_is():
    text = " ".join(Stream.__doc__.split())
    for promise in ("latency", "forward pass", "does not grow", "no gradients", "refused"):
        assert promise in text
