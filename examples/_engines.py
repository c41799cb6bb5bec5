"""Who does the work: this process, or several on this machine."""

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context, parent_process

import torch
from _batch import Task
from _cleaning import FAILED, Options, Outcome, process, skip_finished, warm_up

__all__ = ["DEAD", "Engine", "locally"]

Engine = Callable[[Sequence[Task], Options], Iterator[Outcome]]
"""From tasks to what became of each, as they are done."""

DEAD = "the process that worked on it was killed, twice; it may need more memory than there is"


def locally(
    tasks: Sequence[Task], options: Options, *, workers: int, threads: int
) -> Iterator[Outcome]:
    """Work on several files at once.

    A worker that is killed takes the files with it that it may have held: each of these is tried
    once more, with a worker of its own.

    Args:
        tasks: Files to read and write.
        options: What holds for all.
        workers: Processes; 1: this one.
        threads: Of each process. Results may depend on it in the last digit, not on ``workers``.

    Yields:
        What became of each file.
    """
    waiting, lost, dead = deque[Task](), deque[Task](), deque[Task]()
    yield from skip_finished(tasks, options, waiting)
    if min(workers, len(tasks)) < 2:
        with _threads(threads):
            yield from (process(task, options) for task in waiting)
        return
    while waiting:
        yield from _in_a_pool(waiting, lost, options, workers, threads, ahead=2 * workers)
    again = replace(options, overwrite=True)  # a worker may have died after it had written
    while lost:  # one at a time: what is lost now has killed its worker itself
        yield from _in_a_pool(lost, dead, again, 1, threads, ahead=1)
    yield from (Outcome(task, FAILED, f"{task.source}: {DEAD}") for task in dead)


def _in_a_pool(
    waiting: deque[Task],
    lost: deque[Task],
    options: Options,
    workers: int,
    threads: int,
    *,
    ahead: int,
) -> Iterator[Outcome]:
    """Work until nothing waits or a worker dies; what may have been with it goes to ``lost``.

    ``ahead`` is how many files are handed out at a time.
    """
    # spawned, not forked: a forked copy of torch's thread pool may hang
    workers = min(workers, len(waiting))
    pool = ProcessPoolExecutor(workers, get_context("spawn"), _begin, (threads,))
    running: dict[Future[Outcome], Task] = {}
    try:
        while waiting or running:
            while waiting and len(running) < ahead:
                task = waiting[0]
                with _interrupts_held():
                    # raises where a worker died
                    running[pool.submit(process, task, options)] = task
                waiting.popleft()
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                outcome = future.result()
                del running[future]
                yield outcome
    except BrokenProcessPool:
        lost.extend(task for future, task in running.items() if not _succeeded(future))
        yield from (future.result() for future in running if _succeeded(future))
    except KeyboardInterrupt:  # what has begun is finished, so that no work is lost
        pool.shutdown(cancel_futures=True)
        yield from (future.result() for future in running if _succeeded(future))
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _succeeded(future: Future[Outcome]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


def _begin(threads: int) -> None:
    """In every new process; an interrupt is for the one that hands out the work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warm_up(threads)


def _end_with_parent() -> None:
    """Nobody would be told of what a worker did after that."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes that are started meanwhile hold them back too: loading torch, they would die."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
