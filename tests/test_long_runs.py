"""What only shows after a long time, or with many at once."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from filters_under_test import ALL
from motions import smooth_motion
from torch import nn

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    LearnedPredict,
    LearnedUpdate,
    LiftingDenoiser,
    LiftingStep,
    NonLocalPoseMeans,
    OneEuroFilter,
    Stream,
    in_chunks,
    noise,
    so3,
)

LINUX = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="needs Linux's /proc")
MIB = 2**20


def peak_begins() -> None:
    """Forget the highest memory so far."""
    Path("/proc/self/clear_refs").write_text("5")


def memory(what: str) -> int:
    """``VmRSS``, memory now, or ``VmHWM``, its peak [bytes]."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split(f"{what}:")[1].split()[0])


@LINUX
@pytest.mark.parametrize("frames", [2_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "run", [GaussianFilter(1.0), OneEuroFilter(0.05, 0.1)], ids=["gaussian", "euro"]
)
def test_a_stream_does_not_grow(run, frames, rng):
    stream = Stream(run)
    some = smooth_motion(frames=100, joints=1, rng=rng)
    for t in range(200):
        stream.push(some[t % 100])
    before = memory("VmRSS")
    for t in range(frames):
        result = stream.push(some[t % 100])
    assert memory("VmRSS") - before < 4 * MIB
    assert result.isfinite().all()


@LINUX
@pytest.mark.parametrize("frames", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_a_long_clip_in_pieces_needs_no_more_than_a_short_one(frames, rng):
    run = BilateralFilter(1.0, 0.3)
    q = smooth_motion(frames=1000, joints=2, rng=rng).repeat(frames // 1000, 1, 1)
    in_chunks(run, q[:20_000], frames=10_000)  # what is loaded once
    peak_begins()
    before = memory("VmRSS")
    result = in_chunks(run, q, frames=10_000)
    extra = memory("VmHWM") - before - result.numel() * result.element_size()
    # which frames are missing is known of all; the whole at once takes 130 bytes a rotation
    assert extra < 12 * MIB + 8 * result[..., 0].numel(), f"{extra / MIB:.0f} MiB"


@pytest.mark.parametrize("steps", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_training_on_bad_frames_stays_finite(steps, rng):
    run = nn.ModuleDict(
        {
            "bilateral": BilateralFilter(1.0, 0.3, learnable=True),
            "nonlocal": NonLocalPoseMeans(0.3, patch_radius=1, search_radius=2, learnable=True),
            "lifting": LiftingDenoiser(
                LiftingStep(LearnedPredict(), LearnedUpdate()), levels=1, rule=0.1, learnable=True
            ),
        }
    ).double()
    optimizer = torch.optim.Adam(run.parameters(), lr=1e-2)
    bad = torch.tensor([torch.nan, torch.inf, 0.0, 1e300], dtype=torch.float64)
    for _ in range(steps):
        clean = smooth_motion(frames=16, joints=2, rng=rng)
        q = noise.gaussian(clean, 0.1, generator=rng)
        hit = torch.rand(16, 2, generator=rng) < 0.2
        kind = torch.randint(4, (16, 2, 1), generator=rng)
        q = torch.where(hit[..., None], bad[kind].expand_as(q), q)
        loss = sum(so3.squared_distance(each(q), clean).mean() for each in run.values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        for name, parameter in run.named_parameters():
            assert parameter.isfinite().all(), name


@pytest.mark.parametrize("name", ["bilateral", "nonlocal-joint", "lifting-haar", "auto", "median"])
def test_8_threads_call_one_module_at_once(name, rng):
    run, clips = ALL[name], [smooth_motion(frames=60, rng=rng) for _ in range(16)]
    with torch.no_grad():
        expected = [run(q) for q in clips]

    def called(q):
        with torch.no_grad():
            return run(q)

    with ThreadPoolExecutor(8) as pool:
        for _ in range(3):
            assert all(map(torch.equal, pool.map(called, clips), expected))
