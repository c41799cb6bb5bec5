"""Feed broken files to the readers: each ends in a result or in the one documented error.

python tests/fuzz_readers.py [--cases 100000] [--seed 0] [--kind "bvh, words"]

A case fails if it ends in another error, takes over 2 s, or needs more memory than 64 MiB and ten
times its file. The number of a case makes it again: ``--seed`` takes it with ``--cases 1``.
"""

import argparse
import random
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).parents[1] / "examples"), str(Path(__file__).parent)]

import roma  # loaded before memory is short
from _filter_config import read_config
from fuzzing import generators
from tqdm import tqdm

from torchquat import io

ROOT = Path(__file__).parents[1]
LOADED = roma
SECONDS, ROOM, TIMES = 2.0, 64 * 2**20, 10
# time that is worked, as others may be at work here, too; and time that passes, for what only waits
TIMERS = ((signal.SIGPROF, signal.ITIMER_PROF, 1.0), (signal.SIGALRM, signal.ITIMER_REAL, 10.0))


class TooSlow(BaseException):
    """A case takes too long."""


def read(path: Path) -> None:
    """Read a file with what belongs to its ending, and use what comes."""
    if path.suffix == ".yaml":
        read_config(path)
        return
    motions = []
    if path.suffix in (".pt", ".pkl") or path.suffixes == [".smpl", ".npz"]:
        estimate = io.load_estimate(path, frame_rate=30.0, trust_pickle=path.suffix == ".pkl")
        motions = [estimate.motion(name) for name in estimate.tracks]
    else:
        motions = [io.load(path)]
    for motion in motions:
        assert motion.q[motion.valid].isfinite().all(), "what is valid must be finite"


def outcome(path: Path) -> str:
    """``read``, ``refused``, or what is wrong."""
    expected = ValueError if path.suffix == ".yaml" else io.FormatError
    with _limits(path), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(path)
        except expected as error:
            return "refused" if "\n" not in str(error) else f"an error of several lines: {error}"
        except TooSlow:
            return f"took more than {SECONDS:g} s"
        except BaseException as error:
            return f"{type(error).__name__}: {str(error)[:200]}"
    return "read"


@contextmanager
def _limits(path: Path) -> Iterator[None]:
    """Of time and memory, above what is used already."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    for kind, timer, times in TIMERS:
        signal.signal(kind, _too_slow)
        signal.setitimer(timer, times * SECONDS)
    most = used + ROOM + TIMES * path.stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        for _, timer, _ in TIMERS:
            signal.setitimer(timer, 0.0)


def _too_slow(*_: Any) -> None:
    raise TooSlow


def run(cases: int, seed: int, kinds: list[str] | None = None, progress: bool = False) -> Any:
    """Try many files.

    Returns:
        How often each kind ended how, and a line for every failure.
    """
    made = generators(ROOT)
    chosen = kinds or list(made)
    counts: Counter[tuple[str, str]] = Counter()
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        for number in tqdm(range(seed, seed + cases), disable=not progress or None):
            kind = chosen[number % len(chosen)]
            ending, make = made[kind]
            path = Path(folder) / f"case{ending}"
            path.write_bytes(make(random.Random(number)))
            found = outcome(path)
            known = found in ("read", "refused")
            counts[kind, found if known else "failed"] += 1
            if not known:
                failures.append(f"case {number}, {kind}: {found}")
    return counts, failures


def main() -> int:
    """Print a table and all failures."""
    parser = argparse.ArgumentParser(description="Feed broken files to the readers.")
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", action="append")
    arguments = parser.parse_args()
    start = time.perf_counter()
    counts, failures = run(arguments.cases, arguments.seed, arguments.kind, progress=True)
    for kind in sorted({kind for kind, _ in counts}):
        numbers = (f"{counts[kind, what]:>7} {what}" for what in ("read", "refused", "failed"))
        print(f"{kind:<14}", *numbers)
    print(*failures[:50], sep="\n")
    print(f"{arguments.cases} cases, {len(failures)} failures, {time.perf_counter() - start:.0f} s")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
