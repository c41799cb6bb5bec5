"""How much memory the filters take beyond their input, each in a process of its own.

python examples/benchmark_memory.py [--frames 20000] [--joints 24] [--dtype float32]

Prints what a filter adds to the peak of a process that has loaded the input, as a multiple of it.
Linux only.
"""

import os
import platform
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import jsonargparse
import numpy as np
import roma
import torch
from _command import run
from torch import Tensor, nn
from tqdm import tqdm

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    LiftingDenoiser,
    NonLocalPoseMeans,
    noise,
    so3,
)

FILTERS: dict[str, Callable[[], nn.Module]] = {
    "gaussian, sigma_t 1": lambda: GaussianFilter(1.0),
    "bilateral, radius 3": lambda: BilateralFilter(1.0, 0.3),
    "bilateral, radius 10": lambda: BilateralFilter(3.0, 0.3, radius=10),
    "non-local, pose": lambda: NonLocalPoseMeans(0.1),
    "non-local, joint": lambda: NonLocalPoseMeans(0.1, groups="joint"),
    "lifting, haar": lambda: LiftingDenoiser("haar"),
    "lifting, linear": lambda: LiftingDenoiser("linear"),
    "lifting, linear, 8 spins": lambda: LiftingDenoiser("linear", rule="bayes", cycle_spins=8),
}


def extra_memory(name: str, path: Path) -> int:
    """What a filter adds to the largest resident memory of this process [bytes]."""
    q = torch.from_numpy(np.load(path))
    module = FILTERS[name]()
    with torch.inference_mode():
        module(q[:64])  # what torch sets up once is not the filter's
        before = _peak()
        module(q)
    return _peak() - before


def _peak() -> int:
    """Largest resident memory of this process so far [bytes].

    Not ``getrusage``: on Linux it starts at the peak of the process that started this one.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii")
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024


def measure(name: str, path: Path) -> int:
    """Run :func:`extra_memory` in a fresh process, on one thread."""
    command = [sys.executable, __file__, "--child", name, "--input", str(path)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    return int(done.stdout)


def smooth_noisy(frames: int, joints: int, dtype: torch.dtype) -> Tensor:
    """A random walk of rotations with noise ``(frames, joints, 4)``."""
    generator = torch.Generator().manual_seed(0)
    v = 0.02 * torch.randn(frames, joints, 3, generator=generator).cumsum(0)
    return noise.gaussian(so3.exp(v), 0.02, generator=generator).to(dtype)


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    if arguments.child is not None:
        print(extra_memory(arguments.child, arguments.input))
        return 0
    q = smooth_noisy(arguments.frames, arguments.joints, getattr(torch, arguments.dtype))
    size = q.numel() * q.itemsize
    print(
        f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, ", end=""
    )
    print(f"torch {torch.__version__}, numpy {np.__version__}, roma {roma.__version__}")
    print(f"input: {tuple(q.shape)}, {arguments.dtype}, {size / 2**20:.1f} MiB")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "input.npy"
        np.save(path, q.numpy())
        extra = {n: measure(n, path) for n in tqdm(FILTERS, unit="filter", disable=None)}
    for name, most in extra.items():
        print(f"  {name:<26} {most / size:5.1f} x the input")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all filters; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Peak memory of the filters.", exit_on_error=False
    )
    parser.add_argument("--frames", type=int, default=20000)
    parser.add_argument("--joints", type=int, default=24)
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    parser.add_argument("--child", choices=tuple(FILTERS), help="measure one, in this process")
    parser.add_argument("--input", type=Path, help="what the child loads")
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
