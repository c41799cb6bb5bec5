"""Denoise motion files with a filter from a config.

python examples/denoise.py INPUT [INPUT ...] --output OUT [--config configs/auto.yaml]
       [--filter.init_args.strength 0.8] [--workers N] [--overwrite] [--frame_rate 30]
       [--trust_pickle true]

INPUT is a file (BVH; AMASS, SMPL or plain npz; GVHMR's pt, or pkl of WHAM, PHALP and 4D-Humans), a
folder or a glob; OUT is a file for one input, else a folder that mirrors the inputs. All but the
rotations comes back as it was read. Pickles are read with --trust_pickle true only: reading one
runs what its author put into it.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jsonargparse
import torch
from _batch import Task, plan
from _cleaning import Options, process
from _command import run
from _filter_config import read_config
from tqdm import tqdm

DEFAULT_CONFIG = Path(__file__).parents[1] / "configs" / "auto.yaml"


def _results(tasks: Sequence[Task], options: Options, workers: int) -> Iterator[tuple[bool, str]]:
    """What became of each file, as they are done."""
    if min(workers, len(tasks)) < 2:
        for task in tasks:
            yield process(task, options)
        return
    # spawned, not forked: a forked copy of torch's thread pool may hang
    with ProcessPoolExecutor(
        min(workers, len(tasks)), get_context("spawn"), torch.set_num_threads, (1,)
    ) as pool:
        futures = [pool.submit(process, task, options) for task in tasks]
        for future in as_completed(futures):
            yield future.result()


def _denoise_all(arguments: jsonargparse.Namespace) -> int:
    if arguments.workers < 1:
        raise ValueError(f"workers must be >= 1, got {arguments.workers}.")
    chosen = arguments.filter
    config = read_config(arguments.config, chosen.class_path, chosen.init_args)
    if not 0 < arguments.frame_rate < math.inf:
        raise ValueError(f"frame_rate must be finite and > 0, got {arguments.frame_rate}.")
    options = Options(config, arguments.overwrite, arguments.frame_rate, arguments.trust_pickle)
    tasks = plan(arguments.input, arguments.output, pickles=arguments.trust_pickle)
    failed = 0
    results = _results(tasks, options, arguments.workers)
    for done, line in tqdm(results, total=len(tasks), unit="file", disable=None):
        tqdm.write(line if done else f"error: {line}", file=sys.stdout if done else sys.stderr)
        failed += not done
    if failed and len(tasks) > 1:
        print(f"error: {failed} of {len(tasks)} files failed", file=sys.stderr)
    return 1 if failed else 0


def main(argv: Sequence[str] | None = None) -> int:
    """Denoise files; returns the exit status: 1 if any failed."""
    parser = jsonargparse.ArgumentParser(
        description="Denoise motion files: BVH; AMASS, SMPL, plain npz; GVHMR pt; WHAM, PHALP pkl.",
        exit_on_error=False,
    )
    parser.add_argument("input", nargs="+", help="files, folders or globs")
    parser.add_argument("--output", type=Path, required=True, help="a file, or a folder")
    parser.add_argument("--config", type=Path, default=DEFAULT_CONFIG, help="YAML with a filter")
    parser.add_argument("--filter.class_path", help="another filter than the config's")
    parser.add_argument(
        "--filter.init_args", type=dict[str, Any], default={}, help="single arguments of the filter"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument(
        "--frame_rate", type=float, default=30.0, help="of files that do not hold theirs"
    )
    parser.add_argument(
        "--trust_pickle", type=bool, default=False, help="run pickles: those that you made only"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing outputs")
    return run(parser, argv, _denoise_all)


if __name__ == "__main__":
    sys.exit(main())
