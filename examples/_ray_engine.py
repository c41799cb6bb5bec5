"""Work on a Ray cluster: actors that hold the filter, file paths as work items."""

import logging
import os
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from _batch import Task
from _cleaning import FAILED, Options, Outcome, process, skip_finished, warm_up
from _command import one_line
from _engines import DEAD

try:
    import ray
    from ray.exceptions import RayError, RayTaskError
except ImportError:
    raise ValueError("--engine ray needs Ray: pip install 'torchquat[ray]'") from None

__all__ = ["on_ray"]

TRIES = 2


class _Cleaner:
    """One worker."""

    def __init__(self, options: Options, threads: int, folder: str) -> None:
        warm_up(threads)
        os.chdir(folder)  # paths are relative to it
        self.options = options

    def clean(self, task: Task, again: bool) -> Outcome:
        """Read, filter and write one file; an actor that died of it may have written it."""
        overwrite = self.options.overwrite or again
        return process(task, replace(self.options, overwrite=overwrite))


def on_ray(
    tasks: Sequence[Task], options: Options, *, workers: int, threads: int, address: str | None
) -> Iterator[Outcome]:
    """Work on several files at once, on this machine or a cluster.

    Paths must mean the same on every machine, and ``torchquat`` must be installed there. An actor
    that dies is replaced, and its file tried once more.

    Args:
        tasks: Files to read and write.
        options: What holds for all; the filter runs on a GPU where the cluster has any.
        workers: Actors.
        threads: Of each.
        address: Of a running cluster; ``None``: one is started here, for as long as it takes.

    Yields:
        What became of each file.
    """
    waiting = deque[Task]()
    yield from skip_finished(tasks, options, waiting)
    if not waiting:
        return
    ray.init(
        address=address,
        num_cpus=None if address else max(workers * threads, 1),
        include_dashboard=False if address is None else None,
        log_to_driver=False,
        logging_level=logging.ERROR,
        runtime_env=_environment(address),
    )
    try:
        gpus = int(ray.cluster_resources().get("GPU", 0))
        if gpus:
            options = replace(options, device="cuda")
        folder = str(Path.cwd())
        share = min(gpus / workers, 1.0)
        kind = ray.remote(num_cpus=threads, num_gpus=share)(_Cleaner)
        yield from _handed_out(waiting, lambda: kind.remote(options, threads, folder), workers)
    finally:
        ray.shutdown()


def _handed_out(waiting: deque[Task], new_actor: Any, workers: int) -> Iterator[Outcome]:
    """One file at a time for every actor."""
    tries = Counter[Task]()
    idle = [new_actor() for _ in range(min(workers, len(waiting)))]
    running: dict[Any, tuple[Any, Task]] = {}
    while waiting or running:
        while waiting and idle:
            actor, task = idle.pop(), waiting.popleft()
            tries[task] += 1
            running[actor.clean.remote(task, tries[task] > 1)] = actor, task
        done, _ = ray.wait(list(running))
        for reference in done:
            actor, task = running.pop(reference)
            try:
                yield ray.get(reference)
                idle.append(actor)
            except RayTaskError as error:  # raised by Python, not by what became of the process
                idle.append(actor)
                yield Outcome(task, FAILED, f"{task.source}: {one_line(error.cause or error)}")
            except RayError:  # the actor, its machine, or what watches over its memory
                idle.append(new_actor())
                if tries[task] < TRIES:
                    waiting.append(task)
                else:
                    yield Outcome(task, FAILED, f"{task.source}: {DEAD}")


def _environment(address: str | None) -> dict[str, Any]:
    """What actors need besides the installed packages: the files beside this one."""
    if address is None:
        path = [str(Path(__file__).parent), *filter(None, sys.path)]
        return {"env_vars": {"PYTHONPATH": os.pathsep.join(path)}}
    return {"working_dir": str(Path(__file__).parent), "excludes": ["data"]}
