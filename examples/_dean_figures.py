"""Fig. 4 to 6 of Dean's paper, drawn for :mod:`reproduce_dean`."""

from pathlib import Path

import torch
from _figures import plt, save
from torch import Tensor

from torchquat import so3

__all__ = ["figure_4", "figure_5", "figure_6", "widest_channel"]


def figure_4(signals: dict[str, Tensor], frame_rate: float, path: Path) -> None:
    """All channels of several motions ``(T, J, 4)`` side by side, the clean one first."""
    clean = next(iter(signals.values()))
    figure, axes = plt.subplots(1, len(signals), figsize=(13, 4.5), sharey=True)
    for ax, (title, q) in zip(axes, signals.items(), strict=True):
        time = torch.arange(len(q)) / frame_rate
        ax.plot(time, _channels(q, clean).flatten(1), linewidth=0.6)
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("time [s]")
    axes[0].set_ylabel("components of the rotation vectors [rad]")
    save(figure, path)


def figure_5(
    clean: Tensor, pairs: dict[str, tuple[Tensor, Tensor]], channel: tuple[int, int], path: Path
) -> None:
    """One channel, noisy and filtered, for several noises."""
    figure, axes = plt.subplots(len(pairs), 1, figsize=(11, 8), sharex=True)
    for ax, (title, (noisy, filtered)) in zip(axes, pairs.items(), strict=True):
        for q, color, width, label in (
            (noisy, "0.75", 0.8, "noisy"),
            (clean, "black", 1.6, "ground truth"),
            (filtered, "#c44e52", 1.2, "non-local pose means"),
        ):
            ax.plot(_curve(q, clean, channel), color=color, linewidth=width, label=label)
        ax.set_title(f"noise {title}", fontsize=10)
        ax.set_ylabel("[rad]")
    axes[0].legend(ncols=3, fontsize=8)
    axes[-1].set_xlabel("frame")
    save(figure, path)


def figure_6(
    clean: Tensor, outputs: dict[str, dict[str, Tensor]], channel: tuple[int, int], path: Path
) -> None:
    """One channel, all methods over each other, for two noises."""
    figure, axes = plt.subplots(len(outputs), 1, figsize=(11, 7), sharex=True)
    for ax, (title, methods) in zip(axes, outputs.items(), strict=True):
        ax.plot(
            _curve(clean, clean, channel),
            color="black",
            linewidth=2.2,
            label="ground truth",
        )
        for label, q in methods.items():
            ax.plot(_curve(q, clean, channel), linewidth=0.9, label=label)
        ax.set_title(f"noise {title}", fontsize=10)
        ax.set_ylabel("[rad]")
    axes[0].legend(ncols=4, fontsize=8)
    axes[-1].set_xlabel("frame")
    save(figure, path)


def _curve(q: Tensor, clean: Tensor, channel: tuple[int, int]) -> Tensor:
    joint, axis = channel
    return _channels(q, clean)[:, joint, axis]


def _channels(q: Tensor, clean: Tensor) -> Tensor:
    """Rotation vectors ``(T, J, 3)`` from the first clean pose: none is torn apart at pi."""
    return so3.between(clean[:1], q)


def widest_channel(clean: Tensor) -> tuple[int, int]:
    """Joint and axis that turn furthest."""
    values = _channels(clean, clean)
    joint, axis = divmod(int((values.amax(0) - values.amin(0)).argmax()), 3)
    return joint, axis
