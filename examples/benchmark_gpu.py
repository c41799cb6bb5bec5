"""How near the filters come to the speed of a GPU's memory.

python examples/benchmark_gpu.py [--quaternions 1e7 1e8] [--joints 24] [--compiled] [--device cuda]

Each filter is timed forward and with the backward pass, as it is or compiled, on many sequences of
a thousand frames in float32. Its share is the time of a copy of the input over its own.
"""

import math
import platform
import sys
from collections.abc import Callable, Sequence

import jsonargparse
import torch
from _command import run
from torch import Tensor, nn
from torch.utils.benchmark import Timer
from tqdm import tqdm

from torchquat import BilateralFilter, GaussianFilter, LiftingDenoiser, NonLocalPoseMeans

FRAMES = 1000
FILTERS: dict[str, Callable[[], nn.Module]] = {
    "gaussian, radius 3": lambda: GaussianFilter(1.0),
    "bilateral, radius 3": lambda: BilateralFilter(1.0, 0.3),
    "non-local, 11 of 21 poses": lambda: NonLocalPoseMeans(0.1),
    "lifting, haar, 4 levels": lambda: LiftingDenoiser("haar"),
}


def motion(quaternions: int, joints: int, device: str) -> Tensor:
    """Smooth and noisy sequences ``(N, T, J, 4)`` of about so many unit quaternions, float32."""
    items = max(round(quaternions / (FRAMES * joints)), 1)
    generator = torch.Generator(device).manual_seed(0)
    step = torch.randn(items, FRAMES, joints, 4, generator=generator, device=device)
    q = torch.nn.functional.normalize(step.mul_(0.02).cumsum_(1).add_(1.0), dim=-1)
    return q.contiguous()


def seconds(function: Callable[[], object]) -> float:
    """Median time of a call, the GPU waited for."""
    timer = Timer("function()", globals={"function": function})
    return timer.blocked_autorange(min_run_time=0.3).median


def with_backward(module: Callable[[Tensor], Tensor], q: Tensor) -> Callable[[], object]:
    """A call that also asks for the gradient of the input."""
    leaf, slope = q.clone().requires_grad_(), torch.ones_like(q)
    return lambda: torch.autograd.grad(module(leaf), leaf, slope)


def forward(module: Callable[[Tensor], Tensor], q: Tensor) -> Callable[[], object]:
    """A call without derivatives."""

    def call() -> Tensor:
        with torch.inference_mode():
            return module(q)

    return call


def measured(call: Callable[[], object], q: Tensor, copying: float) -> str:
    """Time, share of copy speed, and memory beyond the input at the peak."""
    try:
        call()
        extra = _extra_memory(call) / q.nbytes if q.device.type == "cuda" else math.nan
        taken = seconds(call)
    except torch.OutOfMemoryError:
        return "out of memory"
    share = 100 * copying / taken
    return f"{1e9 * taken / q[..., 0].numel():9.4f} ns {share:7.2f} % {extra:6.1f} x the input"


def _extra_memory(call: Callable[[], object]) -> int:
    """Bytes of the GPU's memory at the peak, beyond what was there."""
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    call()
    torch.cuda.synchronize()
    return torch.cuda.max_memory_allocated() - before


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    device = arguments.device
    name = torch.cuda.get_device_name() if device == "cuda" else platform.processor()
    print(f"{name}, torch {torch.__version__}, Python {platform.python_version()}")
    for count in arguments.quaternions:
        q = motion(int(count), arguments.joints, device)
        copying = seconds(q.clone)
        speed = 2 * q.nbytes / copying / 1e9
        print(f"{q[..., 0].numel()} quaternions {tuple(q.shape)}: copied at {speed:.0f} GB/s")
        for label, make in tqdm(FILTERS.items(), leave=False, disable=None):
            module = make().to(device).requires_grad_(False)
            if arguments.compiled:
                label, module = f"{label}, compiled", torch.compile(module, fullgraph=True)
            for kind, call in (("", forward(module, q)), (", backward", with_backward(module, q))):
                print(f"  {label + kind:<48}{measured(call, q, copying)}", flush=True)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure; returns the exit status."""
    parser = jsonargparse.ArgumentParser(description="Filters on a GPU.", exit_on_error=False)
    parser.add_argument("--quaternions", type=float, nargs="+", default=[1e7, 1e8])
    parser.add_argument("--joints", type=int, default=24)
    parser.add_argument("--compiled", action="store_true", help="by torch.compile, full graph")
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda")
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
