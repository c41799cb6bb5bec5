"""Draw a motion before and after a filter: angular speeds, figures and the path of a joint.

python examples/plot_motion.py BEFORE AFTER --output PLOT.png [--joint LeftForeArm] [--start 3]
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import jsonargparse
import matplotlib
import torch
from _command import run
from torch import Tensor

from torchquat import fill_missing, io, metrics
from torchquat.io import Motion

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

BEFORE, AFTER = "#c44e52", "#2a6f97"


def plot_motion(
    before: Motion, after: Motion, path: Path, *, joint: str, start: int, figures: int = 12
) -> None:
    """Write a PNG of both motions.

    Args:
        before: As the estimator gave it; its missing frames are shaded.
        after: As the filter left it.
        path: PNG to write.
        joint: Whose speed and whose path are drawn.
        start: First frame of the figures, which are every third frame.
        figures: How many.

    Raises:
        ValueError: If the motions differ, have no skeleton, or lack the joint or the frame.
    """
    if before.skeleton is None or after.skeleton is None:
        raise ValueError("both motions must have a skeleton.")
    if before.names != after.names or len(before.q) != len(after.q):
        raise ValueError(
            f"both motions must have the same joints and frames, got {len(before.q)} frames of "
            f"{before.names} and {len(after.q)} of {after.names}."
        )
    if not 0 <= start < len(before.q):
        raise ValueError(f"start must be in [0, {len(before.q)}), got {start}.")
    (index,) = before.skeleton.index([joint])
    figure, axes = plt.subplots(3, 1, figsize=(12, 8), height_ratios=[1.2, 1.0, 1.0])
    draw_speed(axes[0], before, after, index)
    frames = range(start, min(start + 3 * figures, len(before.q)), 3)
    filled = before.with_rotations(fill_missing(before.q, before.weight))
    for ax, motion, label, color in (
        (axes[1], filled, "before", BEFORE),
        (axes[2], after, "after", AFTER),
    ):
        draw_figures(ax, motion, frames, color, index)
        ax.set_title(f"{label}, frames {frames[0]} to {frames[-1]}, with the path of {joint}'s end")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def draw_speed(ax: Axes, before: Motion, after: Motion, index: int) -> None:
    """Angular speed of one joint over time, the missing frames of the input shaded."""
    filled = fill_missing(before.q, before.weight)
    time = torch.arange(1, len(filled)) / before.frame_rate
    for q, label, color, width in (
        (filled, "before", BEFORE, 0.9),
        (after.q, "after", AFTER, 1.6),
    ):
        speed = metrics.angular_velocity(q[:, [index]], frame_rate=before.frame_rate).norm(dim=-1)
        ax.plot(time, speed[:, 0], color=color, linewidth=width, label=label)
    for frame in (~before.valid[:, index]).nonzero()[:, 0].tolist():
        ax.axvspan(
            (frame - 0.5) / before.frame_rate, (frame + 0.5) / before.frame_rate, color="0.85"
        )
    ax.set_title(f"{before.names[index]}: angular speed (grey: nobody was found, filled)")
    ax.set(xlabel="time [s]", ylabel="rad/s", xlim=(0, len(filled) / before.frame_rate))
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)


def draw_figures(ax: Axes, motion: Motion, frames: range, color: str, index: int) -> None:
    """Stick figures side by side, seen from the front, and the path of one bone's end."""
    ends, bones = _points(motion)
    drawn = torch.cat([ends, bones.flatten(1, 2)], 1)[..., 1]
    height = float(drawn.max() - drawn.min())
    for place, frame in enumerate(frames):
        shift = bones.new_tensor([0.55 * height * place, 0.0])
        lines = bones[frame, :, :, :2] + shift
        ax.add_collection(LineCollection(list(lines.numpy()), colors=color, linewidths=1.6))
        trail = ends[max(frame - 12, 0) : frame + 1, index, :2] + shift
        ax.plot(*trail.T, color="0.35", linewidth=0.8, marker=".", markersize=2.5)
    ax.set_aspect("equal")
    ax.autoscale()
    ax.axis("off")


def _points(motion: Motion) -> tuple[Tensor, Tensor]:
    """End of every joint's bone ``(T, J, 3)``, and all bones ``(T, bones, 2, 3)``."""
    skeleton = motion.skeleton
    assert skeleton is not None
    rotations, positions = skeleton.forward_kinematics(motion.q)
    ends = positions.clone()
    bones: list[Tensor] = []
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            ends[:, parent] = positions[:, joint]
            bones.append(torch.stack([positions[:, parent], positions[:, joint]], -2))
    tips = skeleton.tips(rotations, positions)
    for tip, (joint, _) in enumerate(skeleton.end_sites):
        ends[:, joint] = tips[:, tip]
        bones.append(torch.stack([positions[:, joint], tips[:, tip]], -2))
    made = torch.stack(bones, 1) if bones else positions[:, :0, None].expand(-1, -1, 2, -1)
    return ends, made


def _plot(arguments: jsonargparse.Namespace) -> int:
    before, after = io.load(arguments.before), io.load(arguments.after)
    plot_motion(before, after, arguments.output, joint=arguments.joint, start=arguments.start)
    print(arguments.output)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Draw one pair of files; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Draw a motion before and after a filter.", exit_on_error=False
    )
    parser.add_argument("before", type=Path, help="motion file")
    parser.add_argument("after", type=Path, help="motion file with the same joints")
    parser.add_argument("--output", type=Path, required=True, help="PNG to write")
    parser.add_argument("--joint", default="LeftForeArm", help="whose speed and path are drawn")
    parser.add_argument("--start", type=int, default=3, help="first frame of the figures")
    return run(parser, argv, _plot)


if __name__ == "__main__":
    sys.exit(main())
