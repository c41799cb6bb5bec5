"""Play a motion file at its frame rate through a stream; draw what goes in and what comes out.

python examples/live.py [INPUT] [--config one_euro] [--output PLOT.png] [--fast]
       [--filter.init_args.min_cutoff 2Hz] [--joint LeftForeArm]

Without --output a window follows the motion, where there is a screen; else out/live.png is written.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jsonargparse
import torch
from _command import run
from _figures import plt, save
from _filter_config import find_config, read_config
from benchmark_stream import quantile
from torch import Tensor
from tqdm import tqdm

from torchquat import Stream, continuous_rotvec, fill_missing, io, metrics, so3
from torchquat.io import Motion

ROOT = Path(__file__).parents[1]
DEMO = ROOT / "examples" / "data" / "sports2d_demo.npz"
BEFORE, AFTER = "#c44e52", "#2a6f97"
WINDOWS = ("MacOSX", "QtAgg", "TkAgg", "GTK3Agg")
REDRAWN = 0.1
"""How often a window is drawn anew [s]: drawing takes longer than a frame."""


class Played(NamedTuple):
    """A motion that has been played.

    Attributes:
        q: What came out, ``(T, J, 4)``.
        times: Seconds that every push took.
        late: By how much the last frame came later than it was due [s].
    """

    q: Tensor
    times: list[float]
    late: float


class Scope:
    """How far one joint has turned over time, as it goes in and comes out.

    Drawn is one component of the rotation vector from its first rotation: the one that varies most.

    Args:
        motion: What goes in; its missing frames are left out.
        joint: Number of the joint that is drawn.
        title: Above the plot.
    """

    def __init__(self, motion: Motion, joint: int, title: str) -> None:
        self.joint = joint
        self.time = (torch.arange(len(motion.q)) / motion.frame_rate).tolist()
        filled = fill_missing(motion.q, motion.weight)
        self.rest, self.axis = filled[0, joint], 0
        vectors = self.turned(filled)
        self.axis = int(vectors.var(0, correction=0).argmax())
        angle = vectors[:, self.axis]
        self.given = torch.where(motion.valid[:, joint], angle, torch.nan)
        self.figure, axes = plt.subplots(figsize=(11, 4))
        (self.before,) = axes.plot([], [], color=BEFORE, linewidth=1.0, label="in")
        (self.after,) = axes.plot([], [], color=AFTER, linewidth=1.8, label="out")
        low, high = float(angle.min()) - 5.0, float(angle.max()) + 5.0
        axes.set(xlim=(0.0, max(self.time[-1], 1e-3)), ylim=(low, high), title=title)
        axes.set(xlabel="time of the frame [s]")
        axes.set(ylabel=f"{motion.names[joint]}, about {'xyz'[self.axis]} [degrees]")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)

    def turned(self, q: Tensor) -> Tensor:
        """Rotation vectors of the joint from its first rotation ``(T, 3)`` [degrees]."""
        turn = so3.relative(self.rest.expand_as(q[:, self.joint]), q[:, self.joint])
        return torch.rad2deg(continuous_rotvec(turn[:, None])[:, 0])

    def show(self, taken: int, out: Sequence[Tensor]) -> None:
        """Draw the first frames that went in, and those that have come out."""
        self.before.set_data(self.time[:taken], self.given[:taken].tolist())
        if out:
            angle = self.turned(torch.stack(list(out)))[:, self.axis]
            self.after.set_data(self.time[: len(out)], angle.tolist())


def play(motion: Motion, stream: Stream, scope: Scope, *, fast: bool, window: bool) -> Played:
    """Push every frame when it is due.

    Args:
        motion: What is played.
        stream: What it is pushed through.
        scope: Where it is drawn.
        fast: Push as fast as they are taken.
        window: Draw along the way.
    """
    out: list[Tensor] = []
    times, start, drawn = [], time.perf_counter(), 0.0
    for t, frame in enumerate(tqdm(motion.q, unit="frame", disable=None)):
        if not fast:
            time.sleep(max(start + t / motion.frame_rate - time.perf_counter(), 0.0))
        before = time.perf_counter()
        result = stream.push(frame, None if motion.weight is None else motion.weight[t])
        times.append(time.perf_counter() - before)
        if result is not None:
            out.append(result)
        if window and before - drawn > REDRAWN:
            scope.show(t + 1, out)
            plt.pause(1e-3)
            drawn = before
    due = start + (len(times) - 1) / motion.frame_rate
    late = 0.0 if fast else max(time.perf_counter() - due, 0.0)
    rest = stream.flush()
    out += [] if rest is None else rest.unbind(-3)
    scope.show(len(out), out)
    return Played(torch.stack(out), times, late)


def summary(motion: Motion, played: Played, stream: Stream) -> str:
    """One line: latency, time per frame, jitter before and after."""
    filled = fill_missing(motion.q, motion.weight)
    rate = motion.frame_rate
    before, after = (float(metrics.jitter(q, frame_rate=rate)) for q in (filled, played.q))
    change = f" ({after / before - 1:+.0%})" if before > 0 else ""
    half, most = (quantile(played.times, share) for share in (0.5, 0.95))
    return (
        f"{len(motion.q)} frames at {rate:g} fps, {type(stream.filter).__name__}: latency "
        f"{1e3 * stream.latency / rate:.0f} ms ({stream.latency} frames), time per frame "
        f"{half:.2f} ms (95 %: {most:.2f} ms), last frame {1e3 * played.late:.0f} ms late, "
        f"jitter {before:,.0f} -> {after:,.0f} rad/s^3{change}"
    )


def _open_window() -> bool:
    """Whether there is a screen, and something that can draw on it."""
    for backend in WINDOWS:
        try:
            plt.switch_backend(backend)
        except ImportError:
            continue
        return True
    return False


def _live(arguments: jsonargparse.Namespace) -> int:
    torch.set_num_threads(1)  # a frame is too small to share
    motion = io.load(arguments.input)
    if len(motion.q) == 0:
        raise ValueError(f"{arguments.input}: expected frames, got none")
    chosen = arguments.filter
    config = read_config(find_config(arguments.config), chosen.class_path, chosen.init_args)
    try:
        stream = Stream(config.build(motion.frame_rate))
    except TypeError as error:
        raise ValueError(f"{config.origin}: {error}") from None
    window = arguments.output is None and not arguments.fast and _open_window()
    title = f"{type(stream.filter).__name__}, latency {stream.latency} frames"
    scope = Scope(motion, _joint(motion, arguments.joint), title)
    played = play(motion, stream, scope, fast=arguments.fast, window=window)
    print(summary(motion, played, stream))
    if window:
        plt.show()
    else:
        path = arguments.output or Path("out/live.png")
        save(scope.figure, path)
        print(path)
    return 0


def _joint(motion: Motion, name: str | None) -> int:
    """Number of a joint; of the one that turns most where none is named."""
    if name is None and len(motion.q) == 1:
        return 0  # nothing turns in one frame
    if name is None:
        filled = fill_missing(motion.q, motion.weight)
        return int(so3.distance(filled[:-1], filled[1:]).median(0).values.argmax())
    if name not in motion.names:
        raise ValueError(f"joint must be one of {', '.join(motion.names)}, got {name!r}.")
    return motion.names.index(name)


def main(argv: Sequence[str] | None = None) -> int:
    """Play one file; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Play a motion file through a filter, frame by frame.", exit_on_error=False
    )
    parser.add_argument("input", type=Path, nargs="?", default=DEMO, help="motion file")
    parser.add_argument("--config", default="bilateral", help="preset, or YAML with a filter")
    parser.add_argument("--filter.class_path", help="another filter than the config's")
    parser.add_argument(
        "--filter.init_args", type=dict[str, Any], default={}, help="single arguments of the filter"
    )
    parser.add_argument("--joint", help="which is drawn (default: the one that turns most)")
    parser.add_argument("--output", type=Path, help="PNG to write instead of a window")
    parser.add_argument("--fast", action="store_true", help="do not wait for real time")
    return run(parser, argv, _live)


if __name__ == "__main__":
    sys.exit(main())
