"""A page and pictures that show what was done to a clip."""

import base64
import html
from pathlib import Path
from tempfile import TemporaryDirectory

from _clip_plots import AFTER, BEFORE, FAR, REPAIRED, Clip, draw_plots, looked_at, stretches

from torchquat import metrics
from torchquat.io import Motion

__all__ = ["write_report"]

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 1200px; padding: 0 16px; }
iframe { border: 1px solid #ddd; height: 560px; width: 100%; box-sizing: border-box; }
.strip { height: 14px; margin: 4px 99px 0 97px; position: relative; background: #eee; }
.strip i { position: absolute; top: 0; bottom: 0; min-width: 2px; }
td { padding: 0 24px 0 0; } img { max-width: 100%; } h1 { font-size: 22px; }
b.key { display: inline-block; width: 12px; height: 12px; margin: 0 4px 0 12px; }
"""
LISTED = 40
"""Repaired stretches that are named one by one."""


def write_report(before: Motion, after: Motion, folder: Path, title: str) -> list[Path]:
    """Draw a clip before and after.

    Args:
        before: As it came; missing frames have weight 0 or no finite values.
        after: As the filter left it.
        folder: Gets ``index.html``, which opens from the disk and loads nothing, and four PNG
            files; each appears whole.
        title: Of the page.

    Returns:
        What was written.

    Raises:
        ValueError: If the motions differ in joints or frames, or viser is not installed.
    """
    clip = looked_at(before, after)
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".report-", dir=folder) as name:
        plots = draw_plots(clip, Path(name))
        page = Path(name) / "index.html"
        page.write_text(_page(clip, before, plots, title), encoding="utf-8")
        return [_moved(path, folder) for path in (*plots, page)]


def _moved(path: Path, folder: Path) -> Path:
    return path.replace(folder / path.name)


def _page(clip: Clip, before: Motion, plots: list[Path], title: str) -> str:
    pictures = "".join(
        f'<p><img alt="{path.stem}" src="data:image/png;base64,'
        f'{base64.b64encode(path.read_bytes()).decode()}"></p>'
        for path in plots
    )
    name = html.escape(title)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title>'
        f'<link rel="icon" href="data:,"><style>{STYLE}</style></head><body><h1>{name}</h1>'
        f"{_skeletons(clip, before)}{_table(clip)}{pictures}</body></html>"
    )


def _skeletons(clip: Clip, before: Motion) -> str:
    """The player, what its colours mean, and where something was repaired."""
    skeleton = before.skeleton
    if skeleton is None or not (skeleton.end_sites or max(skeleton.parents, default=-1) >= 0):
        return "<p>The file has no skeleton that could be drawn.</p>"
    from _clip_player import MOST, player  # viser takes a second to load

    step = -(-len(clip.before) // MOST)
    played = player(skeleton, clip.before, clip.after, clip.repaired, clip.frame_rate)
    keys = "".join(
        f'<b class="key" style="background:{color}"></b>{what}'
        for color, what in (
            (BEFORE, "before"),
            (AFTER, "after"),
            (REPAIRED, f"repaired: was missing, or turned by more than {FAR:.0f} degrees"),
        )
    )
    thinned = f" Every {step}th frame is shown." if step > 1 else ""
    return (
        f"<p>{keys}.{thinned}</p>"
        f'<iframe title="both skeletons" srcdoc="{html.escape(played)}"></iframe>'
        f"{_strip(clip)}"
    )


def _strip(clip: Clip) -> str:
    """Repaired frames below the time bar, and in words."""
    frames = len(clip.before)
    found = stretches(clip.repaired.any(1))
    marks = "".join(
        f'<i style="background:{REPAIRED};left:{100 * start / frames:.3f}%;'
        f'width:{100 * (stop - start) / frames:.3f}%"></i>'
        for start, stop in found
    )
    named = ", ".join(
        str(start) if stop == start + 1 else f"{start} to {stop - 1}"
        for start, stop in found[:LISTED]
    )
    more = f" and {len(found) - LISTED} more stretches" if len(found) > LISTED else ""
    said = f"Repaired in frames {named}{more}." if found else "Nothing had to be repaired."
    return f'<div class="strip" title="repaired frames">{marks}</div><p>{said}</p>'


def _table(clip: Clip) -> str:
    jitter = [
        float(metrics.jitter(q, frame_rate=clip.frame_rate)) for q in (clip.before, clip.after)
    ]
    kept = float(metrics.peak_speed_kept(clip.after, clip.before))
    rows = (
        ("frames", f"{len(clip.before)} at {clip.frame_rate:g} per second"),
        ("joints", str(len(clip.names))),
        ("missing", f"{int(clip.missing.sum())} of {clip.missing.numel()} joint samples"),
        ("jitter", f"{jitter[0]:,.0f} before, {jitter[1]:,.0f} after [rad/s³]"),
        ("change", f"{float(clip.change.square().mean().sqrt()):.2f} degrees, root mean square"),
        ("peak speed kept", f"{kept:.0%}"),
    )
    cells = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)
    return f"<table>{cells}</table>"
