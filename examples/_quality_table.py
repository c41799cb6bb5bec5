"""The oracle that tunes the baselines, and the table as text."""

from dataclasses import dataclass

import numpy as np
from _quality_clips import CLEAN
from _quality_methods import KINDS, NOISY

__all__ = ["TUNED_KINDS", "Row", "table", "tuned"]

Array = np.ndarray
TUNED_KINDS = ("wrong", "usual", "paper")
FOR_CLEAN = "5"
"""Clean clips see the setting that is best for this column: nobody tunes for clean motion."""


@dataclass(frozen=True)
class Row:
    """What a method reached, tuned for every column.

    Attributes:
        kind: One of the kinds of methods.
        columns: Names of the columns.
        clips: Names of the clips.
        psnr: PSNR ``(clips, columns)`` [dB].
        kept: Share of peak angular speed kept, of the same shape.
        change: Mean angle to the clean motion, of the same shape [deg].
        settings: The best of every column.
    """

    kind: str
    columns: list[str]
    clips: list[str]
    psnr: Array
    kept: Array
    change: Array
    settings: list[str]


def tuned(found: dict[str, Array], kind: str, columns: list[str], clips: list[str]) -> Row:
    """Take the best setting of every column: the highest mean PSNR over the clips."""
    names = list(found)
    figures = np.stack([found[name] for name in names])  # (settings, clips, columns, 3)
    finite = np.nan_to_num(figures[..., 0], nan=-1e3, posinf=1e3)
    best = finite.mean(1).argmax(0)
    if CLEAN in columns and FOR_CLEAN in columns:
        best[columns.index(CLEAN)] = best[columns.index(FOR_CLEAN)]
    psnr, kept, change = np.stack([figures[b, :, c] for c, b in enumerate(best)], 1).transpose(
        2, 0, 1
    )
    return Row(kind, columns, clips, psnr, kept, change, [names[b] for b in best])


def table(rows: dict[str, Row], title: str) -> str:
    """Mean and worst PSNR, what is lost, and what the oracle chose."""
    first = rows[NOISY]
    noises = [c for c, name in enumerate(first.columns) if name != CLEAN]
    names = [first.columns[c] for c in noises]
    lines = [f"{title}: {len(first.clips)} clips", "PSNR [dB], mean over clips", _head(names)]
    lines += _by_kind(rows, lambda row: row.psnr[:, noises].mean(0), "7.1f")
    lines += _margins(rows, noises)
    lines += ["PSNR [dB], worst clip", _head(names)]
    lines += _by_kind(rows, lambda row: row.psnr[:, noises].min(0), "7.1f")
    lines += ["Peak angular speed, share of the clean one; mean over clips", _head(first.columns)]
    lines += _by_kind(rows, lambda row: row.kept.mean(0), "7.3f")
    lines += _about_clean(rows, first)
    lines += ["Settings that the oracle chose, by column"]
    lines += [
        f"  {name:<26}{'; '.join(row.settings[c] for c in noises)}"
        for name, row in rows.items()
        if any(row.settings)
    ]
    return "\n".join(lines)


def _by_kind(rows: dict[str, Row], figures, form: str) -> list[str]:
    lines = []
    for kind, meaning in KINDS.items():
        same = {name: row for name, row in rows.items() if row.kind == kind}
        lines += [f" {meaning}:"] if same and kind != "input" else []
        lines += [_line(name, figures(row), form) for name, row in same.items()]
    return lines


def _margins(rows: dict[str, Row], noises: list[int]) -> list[str]:
    """The best of the tuned methods, kind by kind, and by how much each of ours beats it."""
    means = {name: row.psnr[:, noises].mean(0) for name, row in rows.items()}
    groups = {"usual": ("usual",), "paper": ("paper",), "any": TUNED_KINDS}
    lines = []
    for label, kinds in groups.items():
        names = [name for name, row in rows.items() if row.kind in kinds]
        if not names:
            continue
        values = np.stack([means[name] for name in names])
        best = values.max(0)
        lines.append(_line(f"best ({label})", best, "7.1f"))
        lines += [
            _line(f"{name} - best", means[name] - best, "+7.1f")
            for name, row in rows.items()
            if row.kind == "ours"
        ]
        winners = zip(noises, values.argmax(0), strict=True)
        said = [f"{rows[NOISY].columns[c]}: {names[winner]}" for c, winner in winners]
        lines.append(f"    {', '.join(said)}")
    return lines


def _about_clean(rows: dict[str, Row], first: Row) -> list[str]:
    """What is done to clean clips."""
    if CLEAN not in first.columns:
        return []
    c = first.columns.index(CLEAN)
    lines = [
        f"Clean clips, setting of column {FOR_CLEAN}: change [deg] and peak speed kept",
        f"  {'':<26}{'mean':>8}{'worst':>8}{'kept':>8}{'worst':>8}",
    ]
    for name, row in rows.items():
        change, kept = row.change[:, c], row.kept[:, c]
        values = (change.mean(), change.max(), kept.mean(), kept.min())
        lines.append(f"  {name:<26}" + "".join(f"{value:8.3f}" for value in values))
    return lines


def _head(columns: list[str]) -> str:
    return f"  {'':<26}" + "".join(f"{column:>10}" for column in columns)


def _line(name: str, values: Array, form: str) -> str:
    return f"  {name:<26}" + "".join(f"{format(value, form):>10}" for value in values)
