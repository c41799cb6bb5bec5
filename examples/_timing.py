"""Times of several jobs, taken in turn so that all see the same machine."""

import time
from collections.abc import Callable

from tqdm import tqdm

__all__ = ["Job", "in_turn"]

Job = Callable[[], object]


def in_turn(jobs: dict[str, Job], rounds: int = 9, least: float = 0.02) -> dict[str, list[float]]:
    """Seconds of every job in every round, one after the other.

    Args:
        jobs: What is timed.
        rounds: How often; a job of more than a second runs twice in all.
        least: Short jobs run several times a round, for about so long [s].

    Returns:
        Seconds of each run, without the first, which sets things up.
    """
    times: dict[str, list[float]] = {name: [] for name in jobs}
    bar = tqdm(total=(rounds + 1) * len(jobs), unit="run", leave=False, disable=None)
    for done in range(rounds + 1):
        for name, job in jobs.items():
            known = times[name]
            if done < 2 or known[0] < 1.0:
                repeats = max(1, min(20, round(least / known[0]))) if known else 1
                known.append(_timed(job, repeats))
            bar.update()
    bar.close()
    return {name: each[1:] for name, each in times.items()}


def _timed(job: Job, repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        job()
    return (time.perf_counter() - start) / repeats
