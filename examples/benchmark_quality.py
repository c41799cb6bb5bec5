"""Which filter comes nearest to the clean motion, and what does it lose on the way?

python examples/benchmark_quality.py [--clips FOLDER] [--output out/quality] [--seeds 0 1 2]
       [--rates 120 30] [--columns 5 impulse] [--methods Gaussian AutoDenoiser] [--frames 300]
       [--start 0] [--quick]

Clips x noises x methods x frame rates. Every baseline is tuned by an oracle: of a grid of settings,
the one that is best for a column on average over the very clips that it is judged on. What is said
to need no parameter gets none. Runs on the clips beside the project, on any folder of BVH files, or
on made-up motion where there is neither. Writes quality.txt and quality.png.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import jsonargparse
import numpy as np
import torch
from _command import run
from _quality_clips import CLEAN, COLUMNS, Clip, corrupted, paths_of, read
from _quality_methods import NOISY, Method, methods
from _quality_plot import plot
from _quality_table import Row, table, tuned
from torch import Tensor
from tqdm import tqdm

from torchquat import metrics, so3

__all__ = ["main"]

QUICK_FRAMES, QUICK_CLIPS, QUICK_STEP = 48, 2, 6
QUICK_COLUMNS = [CLEAN, "5", "impulse"]


def measured(made: Tensor, clean: Tensor) -> Tensor:
    """PSNR, peak speed kept and change [deg] of ``(columns, seeds, T, J, 4)``: ``(columns, 3)``.

    As ``metrics.psnr`` and ``metrics.peak_speed_kept``, but all columns at a time.
    """
    square = so3.squared_distance(made, clean)
    psnr = 10.0 * torch.log10(math.pi**2 / square.mean((1, 2, 3)))
    peaks, true = (metrics.angular_velocity(q).norm(dim=-1).amax(-2) for q in (made, clean))
    kept = peaks.sum(-1).mean(1) / true.sum()
    return torch.stack([psnr, kept, torch.rad2deg(square.sqrt().mean((1, 2, 3)))], -1)


def judge(
    rows: dict[str, Method], clips: list[Clip], rate: int, columns: list[str], seeds: list[int]
) -> dict[str, dict[str, np.ndarray]]:
    """Figures ``(clips, columns, 3)`` of every setting of every method."""
    found = {name: {setting: [] for setting in row.settings} for name, row in rows.items()}
    jobs = [(clip, name) for clip in clips for name in rows]
    noisy = torch.empty(0)
    for clip, name in tqdm(jobs, unit="method", desc=f"{rate} fps", disable=None):
        if name == next(iter(rows)):
            noisy = corrupted(clip, rate, columns, seeds)
        for setting, denoise in rows[name].settings.items():
            with torch.inference_mode():
                found[name][setting].append(measured(denoise(noisy), clip.q).numpy())
    return {
        name: {setting: np.array(figures) for setting, figures in row.items()}
        for name, row in found.items()
    }


def compare(arguments: jsonargparse.Namespace) -> dict[int, dict[str, Row]]:
    """The tuned rows at every frame rate."""
    rows = chosen(arguments.methods, quick=arguments.quick)
    columns = QUICK_COLUMNS if arguments.quick else arguments.columns
    paths = paths_of(arguments.clips)[: QUICK_CLIPS if arguments.quick else None]
    frames = QUICK_FRAMES if arguments.quick else arguments.frames
    result = {}
    for rate in arguments.rates:
        clips = read(paths, rate, frames, arguments.start)
        found = judge(rows, clips, rate, columns, arguments.seeds)
        names = [clip.name for clip in clips]
        result[rate] = {name: tuned(found[name], rows[name].kind, columns, names) for name in found}
    return result


def chosen(names: list[str] | None, *, quick: bool) -> dict[str, Method]:
    """The methods that are asked for and there, the noisy input first."""
    known = methods()
    _check("methods", names or [], list(known))
    rows = {n: row for n, row in known.items() if names is None or n in (NOISY, *names)}
    for name, row in rows.items():
        if row.missing:
            print(f"skipped: {name}, the installed torchquat has no {row.missing}")
    step = QUICK_STEP if quick else 1
    return {
        name: Method(row.kind, dict(list(row.settings.items())[::step]))
        for name, row in rows.items()
        if not row.missing
    }


def _check(argument: str, names: list[str], known: list[str]) -> None:
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"{argument} must be of {', '.join(known)}, got {', '.join(unknown)}.")


def _benchmark(arguments: jsonargparse.Namespace) -> int:
    _check("columns", arguments.columns, list(COLUMNS))
    for name, least in (("frames", 2), ("start", 0)):
        value = getattr(arguments, name)
        if value is not None and value < least:
            raise ValueError(f"{name} must be >= {least}, got {value}.")
    if min(arguments.rates) < 1:
        raise ValueError(f"rates must be >= 1, got {min(arguments.rates)}.")
    result = compare(arguments)
    text = "\n\n".join(table(rows, f"{rate} fps") for rate, rows in result.items())
    print(text)
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "quality.txt").write_text(text + "\n", encoding="utf-8")
    plot(result, arguments.output / "quality.png")
    print(f"\nwrote {arguments.output}/quality.txt and quality.png")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Write table and plot; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Compare filters on noisy motion.", exit_on_error=False
    )
    parser.add_argument("--clips", type=Path, default=None, help="a folder of BVH files")
    parser.add_argument("--output", type=Path, default=Path("out/quality"), help="a folder")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="a draw for each")
    parser.add_argument("--rates", type=int, nargs="+", default=[120, 30], help="frames per second")
    parser.add_argument("--columns", type=str, nargs="+", default=list(COLUMNS), help="noises")
    parser.add_argument("--methods", type=str, nargs="+", default=None, help="default: all")
    parser.add_argument("--frames", type=int, default=None, help="of every clip, at most")
    parser.add_argument("--start", type=int, default=None, help="first frame; default: the middle")
    parser.add_argument("--quick", action="store_true", help="little of everything: does it run?")
    return run(parser, argv, _benchmark)


if __name__ == "__main__":
    sys.exit(main())
