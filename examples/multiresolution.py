"""What wavelets of rotations are good for besides denoising: compression, features, editing.

python examples/multiresolution.py [INPUT] [--output FOLDER] [--joint LeftForeArm]
       [--gains 1 1 1 1.5 1.5 0 0]

Draws compression.png (error against compression ratio for every wavelet), features.png (frames
where details stand out) and editing.png (one joint with every level scaled by a gain, coarsest
first), and writes the edited motion as edited.bvh or edited.npz. Missing frames are filled first.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import jsonargparse
import numpy as np
import torch
from _command import run
from _figures import plt, save
from torch import Tensor

from torchquat import (
    LiftingTransform,
    compress,
    fill_missing,
    io,
    metrics,
    salience,
    scale_details,
    so3,
    stored_share,
)
from torchquat.filters.lifting import WAVELETS
from torchquat.io import Motion

DEMO = Path(__file__).parent / "data" / "sports2d_demo.npz"
KEPT = (0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02)
FEATURE_LEVELS, EVENTS = 4, 5
GAINS = (1.0, 1.0, 1.5, 1.5, 0.0, 0.0)
"""Coarsest first: the swing of a gesture exaggerated, the tremble taken away."""


def draw_compression(q: Tensor, path: Path) -> list[str]:
    """Error against ratio where only the largest details are kept; returns the figures."""
    figure, ax = plt.subplots(figsize=(8, 4.5))
    lines = ["Compression: ratio and error [deg, root mean square]"]
    for wavelet in WAVELETS:
        transform = LiftingTransform(wavelet)
        smaller = [compress(transform(q), keep) for keep in KEPT]
        ratios = [1.0 / float(stored_share(pyramid)) for pyramid in smaller]
        errors = [float(metrics.geodesic_rmse_deg(transform.inverse(p), q)) for p in smaller]
        ax.plot(ratios, errors, marker=".", label=wavelet)
        pairs = "  ".join(f"{r:4.1f}: {e:5.2f}" for r, e in zip(ratios, errors, strict=True))
        lines.append(f"  {wavelet:<8} {pairs}")
    every = [_held(q, step) for step in (2, 3, 4, 7, 10, 20)]
    ax.plot(*zip(*every, strict=True), color="0.6", linestyle="--", label="every nth frame, slerp")
    pairs = "  ".join(f"{ratio:4.1f}: {error:5.2f}" for ratio, error in every)
    lines.append(f"  {'slerp':<8} {pairs}")
    ax.set(xlabel="compression ratio", ylabel="error [deg, rms]", xscale="log", yscale="log")
    ax.legend(fontsize=8)
    save(figure, path)
    return lines


def _held(q: Tensor, step: int) -> tuple[float, float]:
    """What compression costs without wavelets: every ``step``-th frame kept, slerp between."""
    kept = torch.zeros(q.shape[:-1], dtype=q.dtype)
    kept[::step] = 1.0
    kept[-1] = 1.0
    error = float(metrics.geodesic_rmse_deg(fill_missing(q, kept), q))
    return q.shape[0] / float(kept[:, 0].sum()), error


def draw_features(q: Tensor, names: Sequence[str], frame_rate: float, path: Path) -> list[str]:
    """Where details stand out, as a map of joints and time; returns the highest peaks."""
    score = salience(LiftingTransform("linear", levels=FEATURE_LEVELS)(q))
    whole = score.mean(-1)
    peaks = _peaks(whole, apart=max(round(0.25 * frame_rate), 1))
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(11, 6), sharex=True, height_ratios=[1, 2], layout="constrained"
    )
    top.plot(whole, color="#2a6f97", linewidth=1.0)
    top.plot(peaks, whole[peaks], "v", color="#c44e52")
    top.set_ylabel("salience, mean")
    image = bottom.imshow(
        score.T.numpy(), aspect="auto", interpolation="nearest", vmax=10.0, cmap="magma"
    )
    bottom.set_yticks(range(len(names)), names, fontsize=7)
    bottom.set_xlabel("frame")
    figure.colorbar(image, ax=bottom, label="salience")
    save(figure, path)
    lines = ["Features: frames where details stand out, and the joint that does most"]
    for frame in peaks:
        joint = names[int(score[frame].argmax())]
        times = float(whole[frame])
        place = f"frame {frame:>5} ({frame / frame_rate:6.2f} s)"
        lines.append(f"  {place}: {times:5.1f} times the usual, {joint}")
    return lines


def _peaks(signal: Tensor, apart: int) -> list[int]:
    """The highest maxima, at least ``apart`` frames from each other, in the order of time."""
    found: list[int] = []
    for frame in signal.argsort(descending=True).tolist():
        if all(abs(frame - other) >= apart for other in found):
            found.append(frame)
        if len(found) == EVENTS:
            break
    return sorted(found)


def draw_editing(
    q: Tensor, gains: Sequence[float], names: Sequence[str], joint: int, path: Path
) -> Tensor:
    """Scale every level and put the motion together again; returns it."""
    transform = LiftingTransform("linear", levels=len(gains))
    pyramid = transform(q)
    edited = transform.inverse(scale_details(pyramid, gains))
    rows = {
        "original and edited": None,
        **{f"details of level {len(gains) - k}, gain {g:g}": k for k, g in enumerate(gains)},
    }
    figure, axes = plt.subplots(len(rows), 1, figsize=(11, 1.5 * len(rows)), sharex=True)
    for ax, (title, level) in zip(axes, rows.items(), strict=True):
        if level is None:
            for each, color in ((q, "0.6"), (edited, "#c44e52")):
                ax.plot(_from_first(each, q, joint), color=color, linewidth=1.0)
        else:
            length = pyramid.details[level][:, joint].norm(dim=-1)
            width = 2 ** (len(gains) - level)
            place = width * np.arange(len(length))
            ax.bar(place, length.numpy(), width=width, align="edge", color="#2a6f97")
        ax.set_title(f"{names[joint]}: {title}" if level is None else title, fontsize=8)
        ax.set_ylabel("[rad]", fontsize=8)
    axes[-1].set_xlabel("frame")
    save(figure, path)
    return edited


def _from_first(q: Tensor, reference: Tensor, joint: int) -> Tensor:
    """Angle from the first frame of the reference ``(T,)`` [rad]."""
    return so3.distance(reference[:1, joint : joint + 1], q[:, joint : joint + 1])[:, 0]


def show(
    motion: Motion, folder: Path, *, gains: Sequence[float] = GAINS, joint: str | None = None
) -> list[str]:
    """Write everything; returns what was found, line by line."""
    q = fill_missing(motion.q, motion.weight)
    place = _index(motion.names, joint, q)
    compression = draw_compression(q, folder / "compression.png")
    features = draw_features(q, motion.names, motion.frame_rate, folder / "features.png")
    edited = draw_editing(q, gains, motion.names, place, folder / "editing.png")
    target = folder / f"edited{'.bvh' if motion.skeleton is not None else '.npz'}"
    io.save(motion.with_rotations(edited), target)
    before, after = (metrics.jitter(each, frame_rate=motion.frame_rate) for each in (q, edited))
    return [
        *compression,
        *features,
        f"Editing, gains {' '.join(f'{gain:g}' for gain in gains)}, coarsest level first:",
        f"  jitter {float(before):,.0f} -> {float(after):,.0f} rad/s^3, peak speed x "
        f"{float(metrics.peak_speed_kept(edited, q)):.2f} -> {target}",
    ]


def _index(names: Sequence[str], joint: str | None, q: Tensor) -> int:
    """Where a joint stands; ``None``: the one that turns most."""
    if joint is None:
        return int(metrics.angular_velocity(q).norm(dim=-1).sum(0).argmax())
    if joint not in names:
        raise ValueError(f"joint must be one of {list(names)}, got {joint!r}.")
    return names.index(joint)


def _show(arguments: jsonargparse.Namespace) -> int:
    motion = io.load(arguments.input)
    print(f"{arguments.input}: {len(motion.q)} frames at {motion.frame_rate:g} fps")
    print(*show(motion, arguments.output, gains=arguments.gains, joint=arguments.joint), sep="\n")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Draw one file; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Compression, features and editing of a motion file.", exit_on_error=False
    )
    parser.add_argument("input", type=Path, nargs="?", default=DEMO, help="motion file")
    parser.add_argument("--output", type=Path, default=Path("out/multiresolution"), help="a folder")
    parser.add_argument("--joint", help="whose editing is drawn; else the one that turns most")
    parser.add_argument(
        "--gains", type=float, nargs="+", default=list(GAINS), help="one a level, coarsest first"
    )
    return run(parser, argv, _show)


if __name__ == "__main__":
    sys.exit(main())
