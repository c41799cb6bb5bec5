"""Filters that learn: bandwidths, blocks, and a filter inside a larger net.

python examples/train_filter.py [--parts bandwidths blocks regressor] [--clips FOLDER]
       [--output out/learning] [--seed 0] [--resume] [--scale 1.0] [--quick]

Three parts, each of some minutes on one core: bandwidths and thresholds; lifting blocks and patch
features, which start at the linear wavelet and the plain distance; a regressor whose output passes
a filter before the loss. All learn on noisy copies of some clips, and are compared on others with
the same filters set by hand: the best of a grid on the clips that are learned from.

Writes table.txt, and a folder for everything that learns: checkpoint.pt (loads with
weights_only=True), scalars.csv, and files for TensorBoard where it is installed (extra "train").
"""

import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jsonargparse
import torch
from _command import run
from _learning_data import Data, Figures, judged, read
from _learning_jobs import bandwidths, blocks, learner
from _learning_regressor import regressors
from torch import nn

__all__ = ["main"]

PARTS = {
    "bandwidths": "Bandwidths and thresholds",
    "blocks": "Learned blocks and features",
    "regressor": "A filter inside a regressor",
}
EVERY = 50  # steps between checkpoints
QUICK_SCALE, QUICK_EVERY = 0.02, 2

Row = tuple[str, Figures]


def rows_of(part: str, data: Data, arguments: jsonargparse.Namespace) -> Iterator[Row]:
    """Rows of one part's table, as they are found."""
    quick = arguments.quick
    settings = {
        "resume": arguments.resume,
        "scale": arguments.scale * (QUICK_SCALE if quick else 1.0),
        "every": QUICK_EVERY if quick else EVERY,
    }
    if part == "regressor":
        yield from regressors(data, arguments.output, **settings)
        return
    yield "noisy", judged(nn.Identity(), data, data.unseen)
    learn = learner(data, arguments.output, **settings)
    for name, module in (bandwidths if part == "bandwidths" else blocks)(data, learn):
        yield name, judged(module, data, data.unseen)


def table(rows: list[Row], title: str) -> str:
    """Figures of all rows, and what is won over the last row that was set by hand."""
    columns = ("PSNR [dB]", "worst", "by hand +", "better on", "peak kept")
    lines = [title, f"  {'':<34}" + "".join(f"{column:>11}" for column in columns)]
    by_hand = None
    for name, figures in rows:
        psnr, kept = figures.psnr, figures.kept
        won = better = ""
        if name.endswith("by hand"):
            by_hand = psnr
        elif by_hand is not None:
            won = f"{float((psnr - by_hand).mean()):+.2f}"
            better = f"{int((psnr > by_hand).sum())} of {len(psnr)}"
        cells = (f"{float(psnr.mean()):.2f}", f"{float(psnr.min()):.2f}", won, better)
        cells = (*cells, f"{float(kept.mean()):.0%}")
        lines.append(f"  {name:<34}" + "".join(f"{cell:>11}" for cell in cells))
    return "\n".join(lines)


def _train(arguments: jsonargparse.Namespace) -> int:
    for part in arguments.parts:
        if part not in PARTS:
            raise ValueError(f"parts must be of {', '.join(PARTS)}, got {part}.")
    if not 0.0 < arguments.scale < float("inf"):
        raise ValueError(f"scale must be finite and > 0, got {arguments.scale}.")
    torch.set_num_threads(1)  # tensors are small: more threads wait for each other
    data = read(arguments.clips, arguments.seed, quick=arguments.quick)
    trained, unseen = (
        ", ".join(clip.name for clip in each) for each in (data.trained, data.unseen)
    )
    text = [f"learned from {trained}; judged on {unseen}"]
    print(text[0])
    for part in arguments.parts:
        start = time.perf_counter()
        text.append(table(list(rows_of(part, data, arguments)), PARTS[part]))
        print(f"\n{text[-1]}\n  {time.perf_counter() - start:.0f} s")
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "table.txt").write_text("\n\n".join(text) + "\n", encoding="utf-8")
    print(f"\nwrote {arguments.output}/table.txt")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Train and compare; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Filters that learn, against the same set by hand.", exit_on_error=False
    )
    parser.add_argument("--parts", type=str, nargs="+", default=list(PARTS), help="which")
    parser.add_argument("--clips", type=Path, default=None, help="a folder of BVH files")
    parser.add_argument("--output", type=Path, default=Path("out/learning"), help="a folder")
    parser.add_argument("--seed", type=int, default=0, help="of all draws")
    parser.add_argument("--scale", type=float, default=1.0, help="times the numbers of steps")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoints")
    parser.add_argument("--quick", action="store_true", help="little of everything: does it run?")
    return run(parser, argv, _train)


if __name__ == "__main__":
    sys.exit(main())
