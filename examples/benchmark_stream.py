"""Time of one pushed frame for every filter that can be streamed, eager, one thread.

python examples/benchmark_stream.py [--frames 400] [--joints 24] [--people 1]
"""

import sys
import time
from collections.abc import Sequence

import jsonargparse
import torch
from _command import run
from torch import Tensor, nn

import torchquat as tq
from torchquat import Stream, so3

FILTERS: dict[str, nn.Module] = {
    "gaussian, radius 3": tq.GaussianFilter(1.0),
    "bilateral, radius 3": tq.BilateralFilter(1.0, 0.3),
    "bilateral, causal": tq.BilateralFilter(1.0, 0.3, causal=True),
    "bilateral, two passes": tq.BilateralFilter(1.0, 0.3, iterations=2),
    "non-local, 11 of 21 poses": tq.NonLocalPoseMeans(0.05),
    "non-local, causal": tq.NonLocalPoseMeans(0.05, causal=True),
    "Savitzky-Golay, radius 3": tq.SavitzkyGolayFilter(3, 2),
    "Butterworth, 0.1 a frame": tq.ButterworthFilter(0.1),
    "moving mean": tq.MovingMeanFilter(),
    "median, radius 2": tq.MedianFilter(2),
    "median, two iterations": tq.MedianFilter(2, iterations=2),
    "Hampel, radius 2": tq.HampelFilter(2),
    "One-Euro": tq.OneEuroFilter(0.05, 0.2),
    "Kalman, velocity": tq.KalmanSmoother(0.1, 0.3),
    "Kalman, acceleration": tq.KalmanSmoother(0.1, 0.3, order=3),
}


def frame_times(filter: nn.Module, q: Tensor, weight: Tensor | None = None) -> list[float]:
    """Seconds of every push once the window is full.

    Args:
        filter: What is streamed.
        q: Unit quaternions ``(..., T, J, 4)``.
        weight: Confidence ``(..., T, J)``.
    """
    stream, times = Stream(filter), []
    for t in range(q.shape[-3]):
        frame, trust = q[..., t, :, :], None if weight is None else weight[..., t, :]
        start = time.perf_counter()
        stream.push(frame, trust)
        times.append(time.perf_counter() - start)
    full = 2 * stream.latency + 20
    return times[full:] if len(times) > full else times


def quantile(times: Sequence[float], share: float) -> float:
    """The time [ms] that this share of frames does not exceed."""
    ordered = sorted(times)
    return 1e3 * ordered[min(int(share * len(ordered)), len(ordered) - 1)]


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    torch.set_num_threads(1)
    people = [arguments.people] if arguments.people > 1 else []
    rng = torch.Generator().manual_seed(0)
    noise = torch.randn(*people, arguments.frames, arguments.joints, 3, generator=rng)
    q = so3.exp(0.2 * noise)
    weight = torch.rand(q.shape[:-1], generator=rng) + 0.1
    print(f"{'':28}latency   median   95 %   with weights [ms]")
    for name, each in FILTERS.items():
        plain, weighted = frame_times(each, q), frame_times(each, q, weight)
        print(
            f"{name:28}{Stream(each).latency:7d}{quantile(plain, 0.5):9.2f}"
            f"{quantile(plain, 0.95):7.2f}{quantile(weighted, 0.5):15.2f}"
        )
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Time of one pushed frame, on one core.", exit_on_error=False
    )
    parser.add_argument("--frames", type=int, default=400, help="how many are pushed")
    parser.add_argument("--joints", type=int, default=24, help="joints of a frame")
    parser.add_argument("--people", type=int, default=1, help="people in a frame")
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
