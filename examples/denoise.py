"""Denoise motion files with a filter from a config.

python examples/denoise.py INPUT [INPUT ...] --output OUT [--config configs/auto.yaml]
       [--filter.init_args.strength 0.8] [--workers N] [--overwrite]

INPUT is a file (BVH, AMASS or SMPL npz, plain npz), a folder or a glob; OUT is a file for one
input, else a folder that mirrors the inputs. All but the rotations comes back as it was read.
"""

import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jsonargparse
import torch
from _batch import Task, plan
from _command import one_line, run
from _filter_config import FilterConfig, read_config
from tqdm import tqdm

from torchquat import fill_missing, io, metrics
from torchquat.io import Motion

DEFAULT_CONFIG = Path(__file__).parents[1] / "configs" / "auto.yaml"


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


def summary(before: Motion, after: Motion) -> str:
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


def process(task: Task, config: FilterConfig, overwrite: bool) -> tuple[bool, str]:
    """Read, filter and write one file.

    Returns:
        Whether it was done, and a line that says what was done or what was wrong.
    """
    try:
        if task.target.exists() and not overwrite:
            raise ValueError(f"{task.target}: exists; --overwrite replaces it")
        before = io.load(task.source)
        after = denoise(before, config)
        line = summary(before, after)
        task.target.parent.mkdir(parents=True, exist_ok=True)
        io.save(after, task.target)
    except (ValueError, OSError) as error:
        text = one_line(error)
    except Exception as error:  # a batch goes on, whatever one file does
        text = f"{type(error).__name__}: {one_line(error)}"
    else:
        return True, f"{task.source} -> {task.target}: {line}"
    return False, text if str(task.source) in text else f"{task.source}: {text}"


def _results(
    tasks: Sequence[Task], config: FilterConfig, overwrite: bool, workers: int
) -> Iterator[tuple[bool, str]]:
    """What became of each file, as they are done."""
    if min(workers, len(tasks)) < 2:
        for task in tasks:
            yield process(task, config, overwrite)
        return
    # spawned, not forked: a forked copy of torch's thread pool may hang
    with ProcessPoolExecutor(
        min(workers, len(tasks)), get_context("spawn"), torch.set_num_threads, (1,)
    ) as pool:
        futures = [pool.submit(process, task, config, overwrite) for task in tasks]
        for future in as_completed(futures):
            yield future.result()


def _denoise_all(arguments: jsonargparse.Namespace) -> int:
    if arguments.workers < 1:
        raise ValueError(f"workers must be >= 1, got {arguments.workers}.")
    chosen = arguments.filter
    config = read_config(arguments.config, chosen.class_path, chosen.init_args)
    tasks = plan(arguments.input, arguments.output)
    failed = 0
    results = _results(tasks, config, arguments.overwrite, arguments.workers)
    for done, line in tqdm(results, total=len(tasks), unit="file", disable=None):
        tqdm.write(line if done else f"error: {line}", file=sys.stdout if done else sys.stderr)
        failed += not done
    if failed and len(tasks) > 1:
        print(f"error: {failed} of {len(tasks)} files failed", file=sys.stderr)
    return 1 if failed else 0


def main(argv: Sequence[str] | None = None) -> int:
    """Denoise files; returns the exit status: 1 if any failed."""
    parser = jsonargparse.ArgumentParser(
        description="Denoise motion files (BVH, AMASS or SMPL npz, plain npz).", exit_on_error=False
    )
    parser.add_argument("input", nargs="+", help="files, folders or globs")
    parser.add_argument("--output", type=Path, required=True, help="a file, or a folder")
    parser.add_argument("--config", type=Path, default=DEFAULT_CONFIG, help="YAML with a filter")
    parser.add_argument("--filter.class_path", help="another filter than the config's")
    parser.add_argument(
        "--filter.init_args", type=dict[str, Any], default={}, help="single arguments of the filter"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--overwrite", action="store_true", help="replace existing outputs")
    return run(parser, argv, _denoise_all)


if __name__ == "__main__":
    sys.exit(main())
