"""What is done to one file: read, filter, write, and say in one line what came of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from _batch import ESTIMATORS, Task
from _command import one_line
from _filter_config import FilterConfig

from torchquat import fill_missing, io, metrics
from torchquat.io import Motion

__all__ = ["Options", "denoise", "process"]


@dataclass(frozen=True)
class Options:
    """What holds for all files.

    Attributes:
        config: Which filter.
        overwrite: Whether an output that exists is replaced.
        frame_rate: Of files that do not hold theirs.
        trust_pickle: Whether pickles may be run.
    """

    config: FilterConfig
    overwrite: bool = False
    frame_rate: float = 30.0
    trust_pickle: bool = False


def process(task: Task, options: Options) -> tuple[bool, str]:
    """Read, filter and write one file.

    Returns:
        Whether it was done, and a line that says what was done or what was wrong.
    """
    try:
        if task.target.exists() and not options.overwrite:
            raise ValueError(f"{task.target}: exists; --overwrite replaces it")
        clean = _clean_estimate if _is_estimate(task.source) else _clean_motion
        line = clean(task, options)
    except (ValueError, OSError) as error:
        text = one_line(error)
    except Exception as error:  # a batch goes on, whatever one file does
        text = f"{type(error).__name__}: {one_line(error)}"
    else:
        return True, f"{task.source} -> {task.target}: {line}"
    return False, text if str(task.source) in text else f"{task.source}: {text}"


def denoise(motion: Motion, config: FilterConfig) -> Motion:
    """Filter all rotations; missing frames come back filled.

    Args:
        motion: Rotations with a frame rate, which times in the config are converted with.
        config: Which filter.

    Returns:
        The motion with other rotations. Joints that never move keep theirs to the last bit.
    """
    with torch.inference_mode():
        filtered = config.build(motion.frame_rate)(motion.q, motion.weight)
    still = (motion.q == motion.q[:1]).all(-1).all(0)
    if motion.weight is not None:
        still &= motion.valid.all(0)
    return motion.with_rotations(torch.where(still[:, None], motion.q, filtered))


def _clean_motion(task: Task, options: Options) -> str:
    before = io.load(task.source)
    after = denoise(before, options.config)
    line = _summary(before, after)
    task.target.parent.mkdir(parents=True, exist_ok=True)
    io.save(after, task.target)
    return line


def _clean_estimate(task: Task, options: Options) -> str:
    """All tracks of an estimator's file."""
    estimate = io.load_estimate(task.source, trust_pickle=options.trust_pickle)
    if estimate.frame_rate is None:
        estimate = io.load_estimate(
            task.source, frame_rate=options.frame_rate, trust_pickle=options.trust_pickle
        )
    before = {name: estimate.motion(name) for name in estimate.tracks}
    after = {name: denoise(motion, options.config) for name, motion in before.items()}
    lines = [f"{name}: {_summary(before[name], after[name])}" for name in before]
    task.target.parent.mkdir(parents=True, exist_ok=True)
    clean = estimate.with_rotations({name: motion.q for name, motion in after.items()})
    io.save_estimate(clean, task.target)
    return f"{estimate.producer}; " + "; ".join(lines)


def _is_estimate(path: Path) -> bool:
    if path.suffix.lower() in ESTIMATORS:
        return True
    if path.suffix.lower() != ".npz":
        return False
    try:
        with np.load(path) as archive:  # numbers only: a pickle in it is an error here
            return {"global_orient", "body_pose"} <= set(archive.files)
    except (ValueError, OSError, EOFError, KeyError):  # said better where it is read
        return False


def _summary(before: Motion, after: Motion) -> str:
    """One line: frames, what was missing, jitter before and after, peak speed kept."""
    valid = before.valid
    gaps = int((~valid).sum())
    filled = fill_missing(before.q, before.weight)
    jitter = [float(metrics.jitter(q, frame_rate=before.frame_rate)) for q in (filled, after.q)]
    parts = [f"{len(before.q)} frames"]
    if gaps:
        empty = int((~valid).all(-1).sum())
        parts.append(
            f"{gaps} of {valid.numel()} joint samples missing ({empty} whole frames), filled"
        )
    change = f" ({jitter[1] / jitter[0] - 1:+.0%})" if jitter[0] > 0 else ""
    parts.append(f"jitter {jitter[0]:,.0f} -> {jitter[1]:,.0f} rad/s^3{change}")
    parts.append(f"peak speed kept {float(metrics.peak_speed_kept(after.q, filled)):.0%}")
    return ", ".join(parts)
