"""The table of the benchmark of quality as a picture."""

from pathlib import Path

import numpy as np
from _figures import plt, save
from _quality_clips import CLEAN
from _quality_methods import KINDS, NOISY
from _quality_table import Row

__all__ = ["plot"]

COLOURS = {"wrong": "tab:red", "usual": "tab:gray", "paper": "tab:blue", "ours": "tab:orange"}
MARKERS = "osD^v<>Ph*Xp"


def plot(result: dict[int, dict[str, Row]], path: Path) -> None:
    """Gain over the noisy input, a panel for each frame rate; higher is better."""
    figure, panels = plt.subplots(
        len(result), 1, figsize=(12, 1 + 4.2 * len(result)), squeeze=False, layout="constrained"
    )
    for panel, (rate, rows) in zip(panels[:, 0], result.items(), strict=True):
        _panel(panel, rows)
        panel.set_title(f"{rate} fps, mean of {len(rows[NOISY].clips)} clips")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    save(figure, path)


def _panel(panel, rows: dict[str, Row]) -> None:
    noisy = rows[NOISY]
    noises = [c for c, name in enumerate(noisy.columns) if name != CLEAN]
    rest = {name: row for name, row in rows.items() if name != NOISY}
    # every method has its own place within a column
    places = np.linspace(-0.38, 0.38, max(len(rest), 2))
    lowest = 0.0
    for place, (name, row) in zip(places, _in_order(rest).items(), strict=False):
        gain = (row.psnr - noisy.psnr)[:, noises].mean(0)
        lowest = min(lowest, gain.min())
        same = [other for other in rest if rest[other].kind == row.kind]
        panel.plot(
            np.arange(len(noises)) + place,
            gain,
            MARKERS[same.index(name) % len(MARKERS)],
            color=COLOURS[row.kind],
            markersize=8 if row.kind == "ours" else 5,
            markerfacecolor="none" if row.kind == "wrong" else COLOURS[row.kind],
            label=name,
        )
    for edge in range(len(noises) - 1):
        panel.axvline(edge + 0.5, color="0.9", linewidth=1)
    panel.axhline(0.0, color="0.5", linewidth=1)
    panel.set_ylim(bottom=max(lowest, -12.0) - 1.0)
    panel.set_xticks(range(len(noises)), [noisy.columns[c] for c in noises])
    panel.set_ylabel("gain over the noisy input [dB]")


def _in_order(rows: dict[str, Row]) -> dict[str, Row]:
    """By kind, as in the table."""
    return {name: row for kind in KINDS for name, row in rows.items() if row.kind == kind}
