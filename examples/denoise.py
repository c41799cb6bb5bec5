"""Denoise motion files, one or a whole archive.

python examples/denoise.py INPUT [INPUT ...] --output OUT [--config gentle|default|strong|FILE]
       [--filter.init_args.strength 0.8] [--workers N] [--engine local|ray] [--shard I/N]
       [--overwrite] [--report DIR] [--dry-run]

INPUT is a file (BVH; AMASS, SMPL or plain npz; GVHMR's pt, or pkl of WHAM, PHALP and 4D-Humans), a
folder or a glob; OUT is a file for one input, else a folder that mirrors the inputs. All but the
rotations comes back as it was read. What exists is finished and skipped, so a batch that was
stopped, or killed, goes on where it was; OUT/manifest.jsonl has a line for every file. Pickles are
read with --trust_pickle true only: reading one runs what its author put into it.
"""

import math
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jsonargparse
from _batch import Task, plan, shard
from _batch_report import noise_line, planned, summary
from _cleaning import FAILED, Options, Outcome
from _command import run
from _engines import Engine, locally
from _filter_config import find_config, read_config, shown
from _leftovers import sweep
from _manifest import Manifest
from tqdm import tqdm

EXAMPLES = """examples:
  denoise.py take.bvh --output clean.bvh                     no settings: the noise is estimated
  denoise.py take.bvh --output clean.bvh --config strong     gentle, default, strong, or a YAML file
  denoise.py archive/ --output clean/ --workers 4            a whole folder, four files at a time
  denoise.py archive/ --output clean/ --dry-run              what would be done
  denoise.py take.bvh --output clean.bvh --config gentle --filter.init_args.sigma_t 50ms
  denoise.py --config strong --print_config > mine.yaml      settings to start from

Times take a unit (50ms, 0.1s), cut-offs too (6Hz); each file's frame rate converts them."""


def _denoise_all(arguments: jsonargparse.Namespace) -> int:
    chosen = arguments.filter
    config = read_config(find_config(arguments.config), chosen.class_path, chosen.init_args)
    if arguments.print_config is not None:
        print(shown(config), end="")
        return 0
    options = _options(arguments, config)
    tasks = plan(arguments.input, arguments.output, pickles=arguments.trust_pickle)
    folder = None if tasks[0].target == arguments.output else arguments.output
    tasks = shard(tasks, arguments.shard)
    if not tasks:
        print(f"shard {arguments.shard}: no files")
        return 0
    if line := noise_line(tasks, options):
        print(line, file=sys.stderr)
    if arguments.dry_run:
        print(*planned(tasks, options), sep="\n")
        return 0
    if folder is not None:
        sweep(folder)
    return _run(tasks, options, _engine(arguments), _manifest_of(folder, arguments.shard))


def _run(tasks: Sequence[Task], options: Options, engine: Engine, manifest: Path | None) -> int:
    """Clean all files, and say what became of each and of all."""
    start = time.perf_counter()
    outcomes: list[Outcome] = []
    try:
        for outcome in _recorded(engine(tasks, options), manifest, len(tasks)):
            outcomes.append(outcome)
    finally:  # after an interrupt, too
        if len(tasks) > 1:
            print(*summary(outcomes, time.perf_counter() - start, manifest), sep="\n")
    failed = sum(outcome.status == FAILED for outcome in outcomes)
    if failed and len(tasks) > 1:
        print(f"error: {failed} of {len(tasks)} files failed", file=sys.stderr)
    return 1 if failed else 0


def _recorded(outcomes: Iterator[Outcome], manifest: Path | None, count: int) -> Iterator[Outcome]:
    """Every outcome, printed and written down."""
    record = None if manifest is None else Manifest(manifest)
    try:
        for outcome in tqdm(outcomes, total=count, unit="file", disable=None):
            if record is not None:
                record.write(outcome.record())
            line = f"error: {outcome.line}" if outcome.status == FAILED else outcome.line
            tqdm.write(line, file=sys.stderr if outcome.status == FAILED else sys.stdout)
            yield outcome
    finally:
        if record is not None:
            record.close()


def _options(arguments: jsonargparse.Namespace, config: Any) -> Options:
    if not arguments.input or arguments.output is None:
        raise ValueError("expected INPUT and --output OUT; --help shows how")
    for name in ("workers", "threads"):
        if arguments[name] < 1:
            raise ValueError(f"{name} must be >= 1, got {arguments[name]}.")
    if not 0 < arguments.frame_rate < math.inf:
        raise ValueError(f"frame_rate must be finite and > 0, got {arguments.frame_rate}.")
    return Options(
        config,
        arguments.overwrite,
        arguments.frame_rate,
        arguments.trust_pickle,
        arguments.report,
    )


def _engine(arguments: jsonargparse.Namespace) -> Engine:
    if arguments.engine == "local":
        return partial(locally, workers=arguments.workers, threads=arguments.threads)
    from _ray_engine import on_ray  # Ray takes seconds to load

    return partial(
        on_ray, workers=arguments.workers, threads=arguments.threads, address=arguments.address
    )


def _manifest_of(folder: Path | None, part: str | None) -> Path | None:
    """Every shard writes its own."""
    if folder is None:
        return None
    name = "manifest" if part is None else f"manifest-{part.strip().replace('/', '-of-')}"
    return folder / f"{name}.jsonl"


def _parser() -> jsonargparse.ArgumentParser:
    parser = jsonargparse.ArgumentParser(
        description="Denoise motion files: BVH; AMASS, SMPL, plain npz; GVHMR pt; WHAM, PHALP pkl.",
        epilog=EXAMPLES,
        formatter_class=_Help,
        exit_on_error=False,
    )
    add = parser.add_argument
    add("input", nargs="*", help="files, folders or globs")
    add("--output", type=Path, help="a file for one input, else a folder that mirrors the inputs")
    add("--config", default="default", help="gentle, default, strong, or a YAML file with a filter")
    add("--filter.class_path", help="another filter than the config's")
    add("--filter.init_args", type=dict[str, Any], default={}, help="single arguments of it")
    # jsonargparse hands the option of this name over with an empty value
    add("--print_config", nargs="?", const="", help="print the filter's config and stop")
    add("--dry_run", "--dry-run", action="store_true", help="say what would be done and stop")
    add("--overwrite", action="store_true", help="make outputs that exist again")
    add("--workers", type=int, default=1, help="files at a time")
    add("--threads", type=int, default=1, help="of each worker")
    add("--engine", choices=("local", "ray"), default="local", help="processes here, or Ray")
    add("--address", help="of a running Ray cluster, or auto")
    add("--shard", help="I/N: only the I-th of N parts of the files, for arrays of jobs")
    add("--report", type=Path, help="folder for plots and a page with both skeletons, a clip each")
    add("--frame_rate", type=float, default=30.0, help="of files that do not hold theirs")
    add("--trust_pickle", type=bool, default=False, help="run pickles: those that you made only")
    return parser


class _Help(jsonargparse.DefaultHelpFormatter):
    """Keeps the lines of the examples as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text is EXAMPLES:
            return text
        return super()._fill_text(text, width, indent)


def main(argv: Sequence[str] | None = None) -> int:
    """Denoise files; returns the exit status: 1 if any failed."""
    return run(_parser(), argv, _denoise_all)


if __name__ == "__main__":
    sys.exit(main())
