"""What the filters do to real estimates: jitter, error against a truth, peak speed.

python examples/benchmark_estimates.py [--data ../shared/data] [--output out/estimates]

SMPL poses from video (no truth), joint angles without markers against markers, and the orientation
of an IMU against cameras. No filter is tuned to any of them. Writes estimates.txt.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jsonargparse
import numpy as np
import torch
from _command import run
from _real_input import DATA, Input, imu, markerless, video
from torch import Tensor, nn
from tqdm import tqdm

from torchquat import AutoDenoiser, BilateralFilter, ButterworthFilter, metrics, so3

Figures = dict[str, tuple[float, float, float]]
"""Jitter [rad/s^3], error [deg], NaN without a truth, and share of the peak speed, by filter."""

FILTERS: dict[str, Callable[[float], nn.Module]] = {
    "AutoDenoiser": lambda _: AutoDenoiser(),
    "bilateral, 50 ms": lambda rate: BilateralFilter(0.05 * rate, 0.5),
    "Butterworth, 6 Hz": lambda rate: ButterworthFilter(6.0, frame_rate=rate),
}
KINDS = {"SMPL from video": video, "angles without markers": markerless, "IMU": imu}


def figures(each: Input) -> Figures:
    """Of the estimate as it is, of the truth and of what the filters make of it."""
    made = {"as estimated": each.q}
    if each.truth is not None:
        made["truth"] = each.truth
    with torch.inference_mode():
        made |= {name: make(each.frame_rate)(each.q) for name, make in FILTERS.items()}
    return {name: _measured(q, each) for name, q in made.items()}


def _measured(q: Tensor, each: Input) -> tuple[float, float, float]:
    error = float("nan")
    if each.truth is not None:
        error = float(torch.rad2deg(so3.squared_distance(q, each.truth).mean().sqrt()))
    kept = float(metrics.peak_speed_kept(q, each.q))
    return float(metrics.jitter(q, frame_rate=each.frame_rate)), error, kept


def table(kind: str, found: dict[str, Figures]) -> Iterator[str]:
    """Rows of one kind of input."""
    yield f"{kind}: jitter [rad/s^3] | error [deg] | peak speed kept"
    columns = list(next(iter(found.values())))
    yield f"  {'':24s}" + "".join(f"{column:>28s}" for column in columns)
    for name, row in found.items():
        yield f"  {name:24s}" + "".join(_cell(row[column]) for column in columns)
    mean = {column: _mean([row[column] for row in found.values()]) for column in columns}
    yield f"  {'mean':24s}" + "".join(_cell(mean[column]) for column in columns)


def _mean(rows: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    jitter, error, kept = np.mean(rows, axis=0)
    return float(jitter), float(error), float(kept)


def _cell(row: tuple[float, float, float]) -> str:
    jitter, error, kept = row
    shown = "-" if np.isnan(error) else f"{error:.3f}"
    return f"{jitter:12,.0f} |{shown:>8s} |{kept:5.2f}"


def compare(arguments: jsonargparse.Namespace) -> int:
    """Print and write all tables."""
    found = {kind: list(read(arguments.data)) for kind, read in KINDS.items()}
    if not any(found.values()):
        raise ValueError(f"{arguments.data}: expected estimates/ or imu/ in it, got neither")
    lines = []
    total = sum(map(len, found.values()))
    with tqdm(total=total, unit="input", disable=None) as bar:
        for kind, inputs in found.items():
            rows = {}
            for each in inputs:
                rows[each.name] = figures(each)
                bar.update()
            if rows:
                lines += [*table(kind, rows), ""]
    text = "\n".join(lines)
    print(text)
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "estimates.txt").write_text(text, encoding="utf-8")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Compare; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="What the filters do to real estimates.", exit_on_error=False
    )
    parser.add_argument("--data", type=Path, default=DATA, help="folder with estimates/ and imu/")
    parser.add_argument("--output", type=Path, default=Path("out/estimates"), help="a folder")
    return run(parser, argv, compare)


if __name__ == "__main__":
    sys.exit(main())
