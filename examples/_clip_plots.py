"""Pictures of what a filter did to a clip."""

from pathlib import Path
from typing import NamedTuple

import torch
from _figures import plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torchquat import fill_missing, metrics, so3
from torchquat.io import Motion

__all__ = ["AFTER", "BEFORE", "FAR", "REPAIRED", "Clip", "draw_plots", "looked_at", "stretches"]

BEFORE, AFTER, REPAIRED = "#c44e52", "#2a6f97", "#e69f00"
DRAWN = 6
"""Joints whose curves are drawn."""
COLUMNS = 1200
"""Columns of the heat map, points of a curve: more would not be seen."""
FAR = 20.0
"""A rotation that changed by more than this was repaired, not smoothed [degrees]."""


class Clip(NamedTuple):
    """A motion before and after.

    Attributes:
        before: Rotations as they came, missing ones filled ``(T, J, 4)``.
        after: As the filter left them.
        missing: Which were missing, booleans ``(T, J)``.
        change: Angle between both ``(T, J)`` [degrees].
        names: Of the joints.
        frame_rate: Frames per second.
    """

    before: Tensor
    after: Tensor
    missing: Tensor
    change: Tensor
    names: tuple[str, ...]
    frame_rate: float

    @property
    def repaired(self) -> Tensor:
        """What was filled or turned far, booleans ``(T, J)``."""
        return self.missing | (self.change > FAR)


def looked_at(before: Motion, after: Motion) -> Clip:
    """Compare two motions.

    Raises:
        ValueError: If they have other joints or lengths.
    """
    if before.names != after.names or len(before.q) != len(after.q) or len(before.q) == 0:
        raise ValueError(
            f"both motions must have the same joints and frames, at least one, got "
            f"{len(before.q)} frames of {before.names} and {len(after.q)} of {after.names}."
        )
    filled = fill_missing(before.q, before.weight)
    change = torch.rad2deg(so3.distance(filled, after.q))
    return Clip(filled, after.q, ~before.valid, change, before.names, before.frame_rate)


def draw_plots(clip: Clip, folder: Path) -> list[Path]:
    """Write ``angle.png``, ``speed.png``, ``jitter.png`` and ``change.png``."""
    most = clip.change.square().mean(0).argsort(descending=True)[:DRAWN].tolist()
    turned = {
        name: torch.rad2deg(so3.distance(clip.before[:1], q))
        for name, q in (("before", clip.before), ("after", clip.after))
    }
    speeds = {
        name: metrics.angular_velocity(q, frame_rate=clip.frame_rate).norm(dim=-1)
        for name, q in (("before", clip.before), ("after", clip.after))
    }
    return [
        _curves(clip, most, turned, "angle from the first frame [degrees]", folder / "angle.png"),
        _curves(clip, most, speeds, "angular speed [rad/s]", folder / "speed.png"),
        _bars(clip, folder / "jitter.png"),
        _heat_map(clip, folder / "change.png"),
    ]


def _curves(clip: Clip, joints: list[int], made: dict[str, Tensor], what: str, path: Path) -> Path:
    """One row for each joint that changed most."""
    figure, rows = plt.subplots(
        len(joints), 1, figsize=(11, 1.5 * len(joints) + 0.8), sharex=True, squeeze=False
    )
    for ax, joint in zip(rows[:, 0], joints, strict=True):
        for (name, values), color, width in zip(
            made.items(), (BEFORE, AFTER), (0.8, 1.4), strict=True
        ):
            time, value = _thinned(values[:, joint], clip.frame_rate)
            ax.plot(time, value, color=color, linewidth=width, label=name)
        _shade(ax, clip, joint)
        ax.set_ylabel(clip.names[joint], rotation=0, ha="right", va="center")
    rows[0, 0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
    rows[0, 0].set_title(f"{what}; joints that changed most; orange: repaired", loc="left")
    rows[-1, 0].set(xlabel="time [s]", xlim=(0, max(len(clip.before) / clip.frame_rate, 1e-3)))
    return _written(figure, path)


def _thinned(values: Tensor, frame_rate: float) -> tuple[list[float], list[float]]:
    """Points of a curve; of a long one the lowest and the highest of each stretch."""
    step = -(-2 * len(values) // COLUMNS)
    if step <= 2:
        return (torch.arange(len(values)) / frame_rate).tolist(), values.tolist()
    parts = values[: len(values) // step * step].unflatten(0, (-1, step))
    ends = torch.stack([parts.amin(1), parts.amax(1)], 1).flatten()
    return (torch.arange(len(ends)) * step / (2 * frame_rate)).tolist(), ends.tolist()


def _shade(ax: Axes, clip: Clip, joint: int) -> None:
    for start, stop in stretches(clip.repaired[:, joint]):
        ax.axvspan(start / clip.frame_rate, stop / clip.frame_rate, color=REPAIRED, alpha=0.35)


def stretches(marked: Tensor) -> list[tuple[int, int]]:
    """First frame and the one after the last of every stretch of marked frames."""
    edge = torch.diff(marked.to(torch.int8), prepend=torch.zeros(1), append=torch.zeros(1))
    starts, stops = (edge > 0).nonzero()[:, 0], (edge < 0).nonzero()[:, 0]
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def _bars(clip: Clip, path: Path) -> Path:
    """Jitter of every joint."""
    jitter = [
        [
            float(metrics.jitter(q[:, [joint]], frame_rate=clip.frame_rate))
            for joint in range(q.shape[1])
        ]
        for q in (clip.before, clip.after)
    ]
    height = max(0.22 * len(clip.names), 1.0) + 1.0
    figure, ax = plt.subplots(figsize=(11, height))
    place = torch.arange(len(clip.names))
    for values, color, label, shift in zip(
        jitter, (BEFORE, AFTER), ("before", "after"), (-0.2, 0.2), strict=True
    ):
        ax.barh(place + shift, values, 0.4, color=color, label=label)
    ax.set_yticks(place, clip.names)
    ax.invert_yaxis()
    ax.margins(y=0.01)
    ax.set_title("jitter [rad/s³]", loc="left")
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
    return _written(figure, path)


def _heat_map(clip: Clip, path: Path) -> Path:
    """How far every joint was turned, over time; of a long clip the most of each stretch."""
    step = -(-len(clip.change) // COLUMNS)
    change = torch.nn.functional.pad(clip.change.T, (0, -len(clip.change) % step))
    change = change.unflatten(-1, (-1, step)).amax(-1)
    height = max(0.22 * len(clip.names), 1.0) + 1.2
    figure, ax = plt.subplots(figsize=(11, height))
    duration = len(clip.change) / clip.frame_rate
    image = ax.imshow(
        change.numpy(),
        aspect="auto",
        interpolation="nearest",
        cmap="magma_r",
        extent=(0, duration, len(clip.names) - 0.5, -0.5),
    )
    for joint in range(len(clip.names)):
        for start, stop in stretches(clip.missing[:, joint]):
            ends = [start / clip.frame_rate, stop / clip.frame_rate]
            ax.plot(ends, [joint, joint], color=AFTER, linewidth=2.5, solid_capstyle="butt")
    ax.set_yticks(range(len(clip.names)), clip.names)
    ax.set(xlabel="time [s]", xlim=(0, duration))
    ax.set_title("change [degrees]; blue: was missing", loc="left")
    figure.colorbar(image, ax=ax, pad=0.01)
    return _written(figure, path)


def _written(figure: Figure, path: Path) -> Path:
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    plt.close(figure)
    return path
