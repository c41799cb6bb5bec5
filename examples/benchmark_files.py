"""What reading, filtering and writing a BVH file costs beside reading and writing it with pybvh.

python examples/benchmark_files.py [--frames 2000] [--joints 38]

The file is generated. Medians of several rounds in this process, in turn; for what a command takes
to start, medians of fresh processes.
"""

import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import jsonargparse
import numpy as np
import pybvh
import torch
from _command import run
from _timing import Job, in_turn
from benchmark_memory import smooth_noisy

from torchquat import BilateralFilter, Skeleton, io
from torchquat.io import Motion

HERE = Path(__file__).parent


def generated(frames: int, joints: int) -> Motion:
    """A noisy random walk of a body of chains of four."""
    skeleton = Skeleton(
        names=tuple(f"joint{index}" for index in range(joints)),
        parents=tuple(-1 if index == 0 else max(index - 4, 0) for index in range(joints)),
        offsets=torch.ones(joints, 3, dtype=torch.float64),
        end_sites=(),
    )
    q = smooth_noisy(frames, joints, torch.float64)
    return Motion(q=q, frame_rate=120.0, names=skeleton.names, skeleton=skeleton)


def file_jobs(source: Path, folder: Path) -> dict[str, Job]:
    """Reading and writing with pybvh, and what we do, whole and in parts."""
    module = BilateralFilter()
    motion = io.load(source)
    filtered = motion.with_rotations(module(motion.q))

    def pybvh_reads_and_writes() -> None:
        pybvh.write_bvh_file(pybvh.read_bvh_file(source), folder / "pybvh.bvh")

    def ours() -> None:
        read = io.load(source)
        with torch.inference_mode():
            q = module(read.q, read.weight)
        io.save(read.with_rotations(q), folder / "ours.bvh")

    return {
        "pybvh: read, write": pybvh_reads_and_writes,
        "ours: read, filter, write": ours,
        "  read": lambda: io.load(source),
        "  filter": lambda: module(motion.q),
        "  write": lambda: io.save(filtered, folder / "ours.bvh"),
    }


def start_jobs() -> dict[str, Job]:
    """Fresh processes."""

    def python(*arguments: str) -> Job:
        command = [sys.executable, *arguments]
        return lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    return {
        "import torch": python("-c", "import torch"),
        "import torchquat": python("-c", "import torchquat"),
        "denoise.py --help": python(str(HERE / "denoise.py"), "--help"),
    }


def _print(times: dict[str, list[float]]) -> None:
    seconds = {name: float(np.median(each)) for name, each in times.items()}
    unit = next(iter(seconds.values()))
    for name, each in seconds.items():
        print(f"  {name:<28} {1e3 * each:8.1f} ms {each / unit:6.2f}")


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    torch.set_num_threads(1)
    print(
        f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, ", end=""
    )
    print(", ".join(f"{name} {version(name)}" for name in ("torch", "numpy", "roma", "pybvh")))
    print(f"BVH, {arguments.joints} joints, {arguments.frames} frames")
    with TemporaryDirectory() as name:
        source = Path(name) / "generated.bvh"
        io.save(generated(arguments.frames, arguments.joints), source)
        _print(in_turn(file_jobs(source, Path(name)), arguments.rounds, 0.0))
    print("Start of a process")
    _print(in_turn(start_jobs(), arguments.rounds, 0.0))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure; returns the exit status."""
    parser = jsonargparse.ArgumentParser(description="Speed of files.", exit_on_error=False)
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--joints", type=int, default=38)
    parser.add_argument("--rounds", type=int, default=5)
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
