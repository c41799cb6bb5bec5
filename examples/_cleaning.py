"""What is done to one file: read, filter, write, and say in one line what came of it."""

import importlib
import math
import re
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from _batch import Task
from _command import one_line
from _filter_config import FilterConfig
from _reading import read
from torch import Tensor, nn

from torchquat import fill_missing, in_chunks, io, metrics
from torchquat.chunks import window_of
from torchquat.io import Motion

__all__ = [
    "DONE",
    "FAILED",
    "SKIPPED",
    "Options",
    "Outcome",
    "denoise",
    "process",
    "skip_finished",
    "warm_up",
]

DONE, SKIPPED, FAILED = "done", "skipped", "failed"
STEPS = ("read", "filter", "write", "measure")


@dataclass(frozen=True)
class Options:
    """What holds for all files.

    Attributes:
        config: Which filter.
        overwrite: Whether an output that exists is made again.
        frame_rate: Of files that do not hold theirs.
        trust_pickle: Whether pickles may be run.
        report: Folder for pictures and pages; ``None``: none are made.
        device: Where the filter runs.
    """

    config: FilterConfig
    overwrite: bool = False
    frame_rate: float = 30.0
    trust_pickle: bool = False
    report: Path | None = None
    device: str = "cpu"


@dataclass(frozen=True)
class Outcome:
    """What became of a file.

    Attributes:
        task: Which.
        status: ``done``, ``skipped`` or ``failed``.
        line: What was done, or what was wrong.
        figures: Of each track: frames, joints, missing samples, jitter, peak speed.
        seconds: For each step.
    """

    task: Task
    status: str
    line: str
    figures: tuple[dict[str, Any], ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Frames of all tracks."""
        return sum(figures["frames"] for figures in self.figures)

    def record(self) -> dict[str, Any]:
        """For the manifest."""
        return {
            "input": str(self.task.source),
            "output": str(self.task.target),
            "status": self.status,
            "frames": self.frames,
            "figures": [{k: _written(v) for k, v in each.items()} for each in self.figures],
            "seconds": {step: round(taken, 4) for step, taken in self.seconds.items()},
            "error": self.line if self.status == FAILED else None,
            "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        }


def process(task: Task, options: Options) -> Outcome:
    """Read, filter and write one file.

    Returns:
        What became of it; an output that exists is a finished one, unless it may be overwritten.
    """
    if outcome := _skipped(task, options):
        return outcome
    try:
        return _cleaned(task, options)
    except Exception as error:  # a batch goes on, whatever one file does
        text = _reason(error)
    return Outcome(task, FAILED, text if str(task.source) in text else f"{task.source}: {text}")


def skip_finished(
    tasks: Iterable[Task], options: Options, waiting: deque[Task]
) -> Iterator[Outcome]:
    """Before a batch begins, set aside the files that are finished.

    Whatever output of a waiting file turns up later is the batch's own.

    Args:
        tasks: All files.
        options: What holds for all.
        waiting: Gets those that are to be worked on.

    Yields:
        What became of the others.
    """
    for task in tasks:
        if outcome := _skipped(task, options):
            yield outcome
        else:
            waiting.append(task)


def denoise(motion: Motion, config: FilterConfig, device: str = "cpu") -> Motion:
    """Filter all rotations; missing frames come back filled, and so do positions of the root.

    Args:
        motion: Rotations with a frame rate, which times in the config are converted with.
        config: Which filter.
        device: Where it runs.

    Returns:
        The motion with other rotations. Joints that never move keep theirs to the last bit. A root
        that is nowhere at all stays so.
    """
    run = config.build(motion.frame_rate).to(device)
    q, weight = motion.q.to(device), None if motion.weight is None else motion.weight.to(device)
    with torch.inference_mode():
        # memory does not grow with the length where the window is known
        filtered = in_chunks(run, q, weight) if _sees_a_window(run) else run(q, weight)
    still = (motion.q == motion.q[:1]).all(-1).all(0) & motion.valid.all(0)
    done = motion.with_rotations(torch.where(still[:, None], motion.q, filtered.cpu()))
    if motion.root_position is None:
        return done
    return replace(done, root_position=_without_gaps(motion.root_position))


def _without_gaps(positions: Tensor) -> Tensor:
    """Positions ``(T, 3)``: straight lines across missing frames, ends held."""
    seen = positions.isfinite().all(-1)
    if bool(seen.all()) or not bool(seen.any()):
        return positions
    frames, known = np.arange(len(positions)), seen.numpy()
    columns = positions.numpy().T
    drawn = [np.interp(frames, frames[known], column[known]) for column in columns]
    return torch.where(seen[:, None], positions, torch.from_numpy(np.stack(drawn, -1)))


def _skipped(task: Task, options: Options) -> Outcome | None:
    if options.overwrite or not task.target.exists():
        return None
    line = f"{task.source} -> {task.target}: exists, skipped; --overwrite makes it again"
    return Outcome(task, SKIPPED, line)


def _cleaned(task: Task, options: Options) -> Outcome:
    seconds: dict[str, float] = {step: 0.0 for step in STEPS}
    with _timed(seconds, "read"):
        before, estimate = read(
            task.source, frame_rate=options.frame_rate, trust_pickle=options.trust_pickle
        )
    with _timed(seconds, "filter"):
        after = {
            name: denoise(motion, options.config, options.device) for name, motion in before.items()
        }
    with _timed(seconds, "write"):
        task.target.parent.mkdir(parents=True, exist_ok=True)
        if estimate is None:
            io.save(after[""], task.target)
        else:
            turned = {name: motion.q for name, motion in after.items()}
            io.save_estimate(estimate.with_rotations(turned), task.target)
    with _timed(seconds, "measure"):
        figures = {name: _figures(before[name], after[name]) for name in before}
    lines = [f"{name}: {_said(each)}" if name else _said(each) for name, each in figures.items()]
    line = "; ".join(lines if estimate is None else [estimate.producer, *lines])
    if options.report is not None:
        try:
            _report(task, before, after, options.report)
        except Exception as error:  # whatever it is, the file is there
            raise ValueError(f"{task.source}: cleaned, but no report: {_reason(error)}") from None
    named = tuple({"track": name, **each} if name else each for name, each in figures.items())
    return Outcome(task, DONE, f"{task.source} -> {task.target}: {line}", named, seconds)


def warm_up(threads: int) -> None:
    """Make a new process ready, so that its first file takes no longer than others."""
    torch.set_num_threads(threads)
    importlib.import_module("roma")  # which loads a compiler


def _report(task: Task, before: dict[str, Motion], after: dict[str, Motion], folder: Path) -> None:
    from _clip_report import write_report  # what draws takes seconds to load

    for name in before:
        title = f"{task.source.name}, {name}" if name else task.source.name
        write_report(before[name], after[name], folder / task.place / _inside(name), title)


def _inside(name: str) -> Path:
    """A track's own folder, which its name cannot lead out of."""
    parts = [re.sub(r"^\.+$|[:\0]", "_", part) or "_" for part in re.split(r"[/\\]", name)]
    return Path(*parts) if name else Path()


def _reason(error: Exception) -> str:
    """What went wrong, in one line; its kind, where the text is not written to be read alone."""
    known = isinstance(error, ValueError | OSError)
    return one_line(error) if known else f"{type(error).__name__}: {one_line(error)}"


def _written(value: Any) -> Any:
    """For JSON, which has no NaN."""
    return value if not isinstance(value, float) or math.isfinite(value) else None


@contextmanager
def _timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[step] += time.perf_counter() - start


def _sees_a_window(run: nn.Module) -> bool:
    try:
        window_of(run)
    except (TypeError, ValueError):
        return False
    return True


def _figures(before: Motion, after: Motion) -> dict[str, Any]:
    valid = before.valid
    filled = fill_missing(before.q, before.weight)
    jitter = [float(metrics.jitter(q, frame_rate=before.frame_rate)) for q in (filled, after.q)]
    return {
        "frames": len(before.q),
        "joints": len(before.names),
        "missing": int((~valid).sum()),
        "empty_frames": int((~valid).all(-1).sum()),
        "jitter_before": jitter[0],
        "jitter_after": jitter[1],
        "peak_speed_kept": float(metrics.peak_speed_kept(after.q, filled)),
    }


def _said(figures: dict[str, Any]) -> str:
    """One line: frames, what was missing, jitter before and after, peak speed kept."""
    before, after = figures["jitter_before"], figures["jitter_after"]
    parts = [f"{figures['frames']} frames"]
    if figures["missing"]:
        parts.append(
            f"{figures['missing']} of {figures['frames'] * figures['joints']} joint samples "
            f"missing ({figures['empty_frames']} whole frames), filled"
        )
    change = f" ({after / before - 1:+.0%})" if before > 0 else ""
    parts.append(f"jitter {before:,.0f} -> {after:,.0f} rad/s^3{change}")
    parts.append(f"peak speed kept {figures['peak_speed_kept']:.0%}")
    return ", ".join(parts)
