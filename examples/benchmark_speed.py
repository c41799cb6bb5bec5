"""How fast the filters are beside what people use today: one table, ratios within one run.

python examples/benchmark_speed.py [--frames 2000 20000] [--joints 24 55] [--threads 1 2] [--slow]

Every figure is the median of several runs in this process on the same motion, in nanoseconds per
quaternion, and as a multiple of ``scipy.ndimage.gaussian_filter1d`` on the components. ``--slow``
adds what takes minutes: a loop over windows with scipy's mean of rotations, the pseudo-code of
Courty's paper in loops, and sequences of 200,000 frames. ``--output`` draws time against length.
"""

import platform
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import jsonargparse
import numpy as np
import roma
import scipy
import torch
from _command import run
from _competitors import COMPETITORS, SLOW, smooth_net
from _figures import plt, save
from benchmark_memory import smooth_noisy
from torch import Tensor, nn
from tqdm import tqdm

from torchquat import BilateralFilter, GaussianFilter, LiftingDenoiser, NonLocalPoseMeans

UNIT = "scipy gaussian_filter1d, components"
FILTERS: dict[str, Callable[[], nn.Module]] = {
    "gaussian, radius 3": lambda: GaussianFilter(1.0),
    "bilateral, radius 3": lambda: BilateralFilter(1.0, 0.3),
    "non-local, 11 of 21 poses": lambda: NonLocalPoseMeans(0.1),
    "lifting, haar, 4 levels": lambda: LiftingDenoiser("haar"),
    "lifting, linear, 4 levels": lambda: LiftingDenoiser("linear"),
}
Job = Callable[[], object]


def jobs(q: Tensor, slow: bool) -> dict[str, Job]:
    """Everything that is timed on one motion ``(T, J, 4)``, float32."""
    components = q.double().numpy()
    network = smooth_net(q.shape[1])
    found: dict[str, Job] = {"copy of the tensor": q.clone}
    found |= {name: _bound(each, components) for name, each in COMPETITORS.items()}
    if slow:
        found |= {name: _bound(each, components) for name, each in SLOW.items()}
    found["SmoothNet-shaped network"] = _bound(network, q)
    for name, make in FILTERS.items():
        module = make()
        found[name] = _bound(module, q)
        found[f"{name}, and backward"] = _and_backward(module, q)
    return found


def _bound(function: Callable[..., object], argument: object) -> Job:
    def job() -> object:
        with torch.inference_mode():
            return function(argument)

    return job


def _and_backward(module: nn.Module, q: Tensor) -> Job:
    leaf = q.clone().requires_grad_()
    slope = torch.ones_like(q)

    def job() -> None:
        leaf.grad = None
        module(leaf).backward(slope)

    return job


def seconds(job: Job, least: float = 0.3, most: int = 9) -> float:
    """Median time of a job, once run before; fewer runs where it takes long."""
    start = time.perf_counter()
    job()
    once = time.perf_counter() - start
    times = [once] if once > 5.0 else []
    while not times or (len(times) < most and sum(times) < max(least, 3.0 * once)):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def table(q: Tensor, slow: bool = False) -> dict[str, float]:
    """Nanoseconds per quaternion of every job on one motion."""
    samples = q[..., 0].numel()
    timed = {}
    bar = tqdm(jobs(q, slow).items(), unit="job", leave=False, disable=None)
    for name, job in bar:
        timed[name] = 1e9 * seconds(job) / samples
    return timed


def draw(results: dict[int, dict[str, float]], path: Path) -> None:
    """Time per quaternion against the length of the sequence."""
    figure, ax = plt.subplots(figsize=(9, 5))
    lengths = sorted(results)
    for name in (UNIT, "copy of the tensor", *FILTERS):
        values = [results[frames][name] for frames in lengths]
        ours = name in FILTERS
        ax.plot(lengths, values, marker=".", label=name, linestyle="-" if ours else "--")
    ax.set(xlabel="frames", ylabel="ns per quaternion", xscale="log", yscale="log")
    ax.legend(fontsize=8)
    save(figure, path)


def _lines(timed: dict[str, float]) -> list[str]:
    unit = timed[UNIT]
    return [f"  {name:<42} {value:12.1f} {value / unit:12.2f}" for name, value in timed.items()]


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    print(f"{_processor()}, {platform.system()}, Python {platform.python_version()}")
    print(f"torch {torch.__version__}, numpy {np.__version__}, scipy {scipy.__version__}, ", end="")
    print(f"roma {roma.__version__}")
    for threads in arguments.threads:
        torch.set_num_threads(threads)
        for joints in arguments.joints:
            results = {}
            for frames in arguments.frames:
                results[frames] = table(smooth_noisy(frames, joints, torch.float32), arguments.slow)
                print(
                    f"{frames} frames, {joints} joints, {threads} threads: ns a quaternion, ratio"
                )
                print(*_lines(results[frames]), sep="\n", flush=True)
            if arguments.output is not None:
                draw(results, arguments.output / f"speed_{joints}_joints_{threads}_threads.png")
    return 0


def _processor() -> str:
    """Name of the processor, where the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def main(argv: Sequence[str] | None = None) -> int:
    """Measure; returns the exit status."""
    parser = jsonargparse.ArgumentParser(description="Speed of the filters.", exit_on_error=False)
    parser.add_argument("--frames", type=int, nargs="+", default=[2000, 20000])
    parser.add_argument("--joints", type=int, nargs="+", default=[24])
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--slow", action="store_true", help="also what takes minutes")
    parser.add_argument("--output", type=Path, help="a folder for the plots")
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
