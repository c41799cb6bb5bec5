"""What a batch says of itself: how noisy the files are, what it is going to do, what it did."""

import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from _batch import PICKLES, Task
from _cleaning import DONE, FAILED, SKIPPED, STEPS, Options, Outcome
from _reading import read

from torchquat import noise

__all__ = ["noise_line", "planned", "summary"]

LOOKED_AT = 3
LARGEST = 64_000_000
"""Bytes of a file that is looked at, unless it is the only one."""
DEGREES = 57.29577951308232
FRAMES = 1000
"""How much of a file is looked at."""


def noise_line(tasks: Sequence[Task], options: Options) -> str | None:
    """How large the noise of some of the files is, estimated; ``None`` if none can be read.

    The work waits for it: of many files only some that are to be made and quick to read are looked
    at.
    """
    sizes, found = [], 0
    for task in _looked_at(tasks, options):
        try:
            motions, _ = read(
                task.source, frame_rate=options.frame_rate, trust_pickle=options.trust_pickle
            )
        except Exception:  # said when its turn comes
            continue
        found += 1
        for motion in motions.values():
            weight = None if motion.weight is None else motion.weight[:FRAMES]
            sigma = noise.estimate_sigma(motion.q[:FRAMES], weight)
            sizes += sigma[sigma > 0].tolist()
    if not found:
        return None
    where = f"{found} of {len(tasks)} files" if len(tasks) > 1 else str(tasks[0].source)
    if not sizes:
        return f"noise of {where}: none found"
    low, half, high = (DEGREES * x for x in (min(sizes), statistics.median(sizes), max(sizes)))
    return (
        f"noise of {where}, estimated: {half:.2g} degrees about each axis in the middle joint, "
        f"{low:.2g} to {high:.2g} in all"
    )


def _looked_at(tasks: Sequence[Task], options: Options) -> Iterator[Task]:
    """One file, or of many the first that will do in every part."""
    if len(tasks) == 1:
        yield tasks[0]
        return
    step = -(-len(tasks) // LOOKED_AT)
    for start in range(0, len(tasks), step):
        part = tasks[start : start + step]
        yield from islice((task for task in part if _will_do(task, options)), 1)


def _will_do(task: Task, options: Options) -> bool:
    try:
        if task.target.exists() and not options.overwrite:
            return False
        return task.source.suffix.lower() not in PICKLES and task.source.stat().st_size <= LARGEST
    except OSError:  # said when its turn comes
        return False


def planned(tasks: Sequence[Task], options: Options) -> list[str]:
    """What would be done to every file, and how many there are of each kind."""
    lines, counts = [], Counter[str]()
    for task in tasks:
        there = task.target.exists()
        what = "skip, it exists" if there and not options.overwrite else "make"
        what = "make again" if there and options.overwrite else what
        counts[what] += 1
        lines.append(f"{task.source} -> {task.target}: would {what}")
    size = sum(task.source.stat().st_size for task in tasks)
    counted = ", ".join(f"{count} to {what}" for what, count in counts.items())
    return [*lines, f"{len(tasks)} files, {size / 1e6:,.1f} MB: {counted}"]


def summary(outcomes: Sequence[Outcome], seconds: float, manifest: Path | None) -> list[str]:
    """A table of what a batch did.

    Args:
        outcomes: Of all files.
        seconds: How long it took by the clock.
        manifest: Where each file is recorded.
    """
    counts = Counter(outcome.status for outcome in outcomes)
    done = [outcome for outcome in outcomes if outcome.status == DONE]
    rows = [
        (
            "files",
            f"{len(outcomes)}: {counts[DONE]} done, {counts[SKIPPED]} skipped, "
            f"{counts[FAILED]} failed",
        )
    ]
    if done:
        frames = sum(outcome.frames for outcome in done)
        rows.append(
            ("speed", f"{len(done) / seconds:,.1f} files/s, {frames / seconds:,.0f} frames/s")
        )
        rows.append(("work", _shares(done, seconds)))
        changes = [
            each["jitter_after"] / each["jitter_before"] - 1.0
            for outcome in done
            for each in outcome.figures
            if each["jitter_before"] > 0
        ]
        if changes:
            rows.append(("jitter", f"{statistics.median(changes):+.0%} in the middle file"))
    if manifest is not None:
        rows.append(("manifest", str(manifest)))
    return [f"{name:<10}{text}" for name, text in rows]


def _shares(done: Sequence[Outcome], seconds: float) -> str:
    """Of the time spent on files, how much each step took."""
    steps = {step: sum(outcome.seconds[step] for outcome in done) for step in STEPS}
    total = sum(steps.values())
    if total == 0.0:
        return f"{seconds:,.1f} s"
    parts = ", ".join(f"{step} {taken / total:.0%}" for step, taken in steps.items())
    return f"{seconds:,.1f} s by the clock, {total:,.1f} s on files: {parts}"
