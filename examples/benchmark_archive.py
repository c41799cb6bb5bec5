"""How many files a second a batch takes, by engine and number of workers.

python examples/benchmark_archive.py [--files 200] [--frames 600] [--joints 24] [--config default]

The archive is generated. Every run is a fresh process of ``denoise.py``. The share of the engine is
what of the workers' time, from the first file to the last, was not spent on a file.
"""

import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jsonargparse
from _cleaning import STEPS
from _command import run
from _manifest import read_manifest
from benchmark_files import generated
from tqdm import tqdm

from torchquat import io

COMMAND = [sys.executable, str(Path(__file__).parent / "denoise.py")]


class Batch(NamedTuple):
    """A run over all files.

    Attributes:
        seconds: By the clock, start of the process included.
        working: From the first file to the last.
        steps: Seconds spent on files, by step.
        frames: Of all files.
    """

    seconds: float
    working: float
    steps: dict[str, float]
    frames: int


def batch(archive: Path, output: Path, config: str, engine: str, workers: int) -> Batch:
    """Run ``denoise.py`` once.

    Raises:
        ValueError: If a file failed.
    """
    arguments = [str(archive), "--output", str(output), "--config", config, "--engine", engine]
    start = time.perf_counter()
    done = subprocess.run(
        [*COMMAND, *arguments, "--workers", str(workers)], capture_output=True, text=True
    )
    seconds = time.perf_counter() - start
    if done.returncode:
        raise ValueError(f"denoise.py: expected no failure, got {done.stderr}")
    records = read_manifest(output / "manifest.jsonl")
    steps = {step: sum((each["seconds"][step] for each in records), 0.0) for step in STEPS}
    (said,) = (line for line in done.stdout.splitlines() if line.startswith("work"))
    working = float(said.split()[1].replace(",", ""))
    return Batch(seconds, working, steps, sum(each["frames"] for each in records))


def line(name: str, files: int, made: Batch, workers: int) -> str:
    """One row of the table."""
    busy = sum(made.steps.values())
    shares = "".join(f"{taken / busy:>8.0%}" for taken in made.steps.values())
    idle = max(1.0 - busy / (workers * made.working), 0.0)
    return (
        f"{name:<18}{made.seconds:>8.1f}{files / made.working:>10.1f}"
        f"{made.frames / made.working:>11,.0f}{shares}{idle:>8.0%}"
    )


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    print(f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}", end="")
    print(*("", *(f"{name} {version(name)}" for name in ("torch", "numpy", "ray"))), sep=", ")
    print(
        f"{arguments.files} BVH files, {arguments.joints} joints, {arguments.frames} frames, "
        f"config {arguments.config}"
    )
    with TemporaryDirectory() as name:
        archive = Path(name) / "archive"
        archive.mkdir()
        motion = generated(arguments.frames, arguments.joints)
        for number in tqdm(range(arguments.files), unit="file", disable=None):
            io.save(motion, archive / f"{number}.bvh")
        print(f"{'':<18}{'seconds':>8}{'files/s':>10}{'frames/s':>11}", end="")
        print("".join(f"{step:>8}" for step in STEPS) + f"{'engine':>8}")
        for engine in arguments.engines:
            for workers in arguments.workers:
                output = Path(name) / f"{engine}{workers}"
                made = batch(archive, output, arguments.config, engine, workers)
                print(line(f"{engine}, {workers} workers", arguments.files, made, workers))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure; returns the exit status."""
    parser = jsonargparse.ArgumentParser(description="Speed of batches.", exit_on_error=False)
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--joints", type=int, default=24)
    parser.add_argument("--config", default="default")
    parser.add_argument("--engines", type=list[str], default=["local", "ray"])
    parser.add_argument("--workers", type=list[int], default=[1, 2])
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
