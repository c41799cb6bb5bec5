"""How fast the filters are beside what people use today: one table, ratios within one run.

python examples/benchmark_speed.py [--frames 200 20000] [--joints 24 55] [--threads 1 2] [--slow]

Every figure is the median of several rounds in this process on the same motion: nanoseconds per
quaternion, and the ratio to ``scipy.ndimage.gaussian_filter1d`` on the components in the same
round. ``--slow`` adds what takes minutes: a loop over windows with scipy's mean of rotations, and
the pseudo-code of Courty's paper in loops. ``--batch`` sequences of the given length are filtered
at once. ``--output`` draws time against length; for memory see ``benchmark_memory.py``.
"""

import itertools
import platform
import sys
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
from _timing import Job, in_turn
from benchmark_memory import smooth_noisy
from torch import Tensor, nn

from torchquat import (
    AutoDenoiser,
    BilateralFilter,
    GaussianFilter,
    LiftingDenoiser,
    NonLocalPoseMeans,
)

UNIT = "scipy gaussian_filter1d, components"
FILTERS: dict[str, Callable[[], nn.Module]] = {
    "gaussian, radius 3": lambda: GaussianFilter(1.0),
    "bilateral, radius 3": lambda: BilateralFilter(1.0, 0.3),
    "non-local, 11 of 21 poses": lambda: NonLocalPoseMeans(0.1),
    "lifting, haar, 4 levels": lambda: LiftingDenoiser("haar"),
    "lifting, linear, 4 levels": lambda: LiftingDenoiser("linear"),
    "auto denoiser": AutoDenoiser,
}


def jobs(q: Tensor, batch: int, slow: bool) -> dict[str, Job]:
    """Everything that is timed on ``batch`` motions side by side ``(T, batch J, 4)``, float32."""
    motions = q.unflatten(1, (batch, -1)).movedim(1, 0).contiguous()
    components = q.double().numpy()
    network = smooth_net(q.shape[1])
    found: dict[str, Job] = {"copy of the tensor": q.clone}
    found |= {name: _bound(each, components) for name, each in COMPETITORS.items()}
    if slow:
        found |= {name: _bound(each, components) for name, each in SLOW.items()}
    found["SmoothNet-shaped network"] = _bound(network, q)
    for name, make in FILTERS.items():
        module = make()
        found[name] = _bound(module, motions)
        found[f"{name}, and backward"] = _and_backward(module, motions)
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


def table(q: Tensor, batch: int = 1, slow: bool = False) -> dict[str, tuple[float, float]]:
    """Nanoseconds per quaternion of every job on one motion, and its median ratio to the unit."""
    samples = q[..., 0].numel()
    times = in_turn(jobs(q, batch, slow))
    unit = times[UNIT]
    return {
        name: (
            1e9 * float(np.median(each)) / samples,
            float(np.median([one / other for one, other in zip(each, unit, strict=False)])),
        )
        for name, each in times.items()
    }


def draw(results: dict[int, dict[str, tuple[float, float]]], path: Path) -> None:
    """Time per quaternion against the length of the sequence."""
    figure, ax = plt.subplots(figsize=(9, 5))
    lengths = sorted(results)
    for name in (UNIT, "copy of the tensor", *FILTERS):
        values = [results[frames][name][0] for frames in lengths]
        ours = name in FILTERS
        ax.plot(lengths, values, marker=".", label=name, linestyle="-" if ours else "--")
    ax.set(xlabel="frames", ylabel="ns per quaternion", xscale="log", yscale="log")
    ax.legend(fontsize=8)
    save(figure, path)


def _lines(timed: dict[str, tuple[float, float]]) -> list[str]:
    return [f"  {name:<42} {value:12.1f} {ratio:12.2f}" for name, (value, ratio) in timed.items()]


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    print(f"{_processor()}, {platform.system()}, Python {platform.python_version()}")
    print(f"torch {torch.__version__}, numpy {np.__version__}, scipy {scipy.__version__}, ", end="")
    print(f"roma {roma.__version__}")
    for threads in arguments.threads:
        torch.set_num_threads(threads)
        for joints, batch in itertools.product(arguments.joints, arguments.batch):
            results = {}
            setting = f"{joints} joints, batch {batch}, {threads} threads"
            for frames in arguments.frames:
                # one body of many joints is a batch to what knows no batches
                q = smooth_noisy(frames, joints * batch, torch.float32)
                results[frames] = table(q, batch, arguments.slow)
                print(f"{frames} frames, {setting}: ns a quaternion, ratio")
                print(*_lines(results[frames]), sep="\n", flush=True)
            if arguments.output is not None:
                name = setting.replace(", ", "_").replace(" ", "_")
                draw(results, arguments.output / f"speed_{name}.png")
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
    parser.add_argument("--batch", type=int, nargs="+", default=[1])
    parser.add_argument("--slow", action="store_true", help="also what takes minutes")
    parser.add_argument("--output", type=Path, help="a folder for the plots")
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
