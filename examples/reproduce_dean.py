"""Redo Table I and Fig. 4 to 6 of Dean, "Non-local Pose Means for Denoising Motion Capture Data".

python examples/reproduce_dean.py [--output FOLDER] [--clip MOTION.bvh --skip 10]
       [--frames 300] [--draws 3]

Writes fig4.png, fig5.png and fig6.png and prints the table and what the paper says beside it. Every
method but the one with the published sigma is tuned for each column on the very motion that it is
judged on, as the paper did. The paper's run is not named: a run of the CMU database stands for it
where it lies beside the project, and a synthetic one elsewhere.
"""

import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jsonargparse
import torch
from _clips import CMU, middle, moving_joints, synthetic_run
from _command import run
from _dean_figures import figure_4, figure_5, figure_6, widest_channel
from torch import Tensor, nn
from tqdm import tqdm

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    LiftingDenoiser,
    LinearFilter,
    NonLocalPoseMeans,
    metrics,
    noise,
)
from torchquat.io import Motion

CMU_CLIP, T_POSE = CMU / "16_36.bvh", 10  # leading frames that are no motion
SIGMA = 0.008  # [rad], as in the paper
LEVELS = (1, 15, 30, 50, 75)
IMPULSE, IMPULSE_SHARE = 0.5, 0.05  # [rad] per axis; the paper names neither
PATCH_RADIUS, SEARCH_RADIUS = 5, 10  # 11 and 21 poses
LIKENESS = tuple(SIGMA * 2.0 ** (0.5 * step) for step in range(-2, 15))  # [rad]
BLENDER = (4.0, 6.0, 4.0, 6.0, 4.0)
PUBLISHED = f"non-local, sigma = {SIGMA}"
TUNED = "non-local, sigma tuned"
MEDIUM = "15 sigma"
OVERLAID = ("Gaussian", "Blender", "wavelet, linear", "bilateral", TUNED)


@dataclass(frozen=True)
class Entry:
    """One cell of the table.

    Attributes:
        psnr: Peak signal-to-noise ratio [dB].
        setting: What was found best.
        q: What came out, ``(draws, T, J, 4)``.
    """

    psnr: float
    setting: str
    q: Tensor


def non_local(sigma: float, **options: object) -> NonLocalPoseMeans:
    """Dean's filter with the paper's window and patch."""
    defaults = {"patch_radius": PATCH_RADIUS, "search_radius": SEARCH_RADIUS}
    return NonLocalPoseMeans(sigma, **{**defaults, **options})


def candidates() -> dict[str, dict[str, nn.Module]]:
    """The methods of the table that the package has, each with the settings to choose from."""
    spans = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
    passes = (1, 2, 4, 8, 16, 32)
    rules = ("universal", "sure", "bayes")
    return {
        "noisy": {"": nn.Identity()},
        "Gaussian": {f"sigma_t {s}": GaussianFilter(s) for s in spans},
        "Blender": {f"{n} passes": repeated(LinearFilter(BLENDER), n) for n in passes},
        "bilateral": {
            f"sigma_t {s}, sigma_g {g:.3f}": BilateralFilter(s, g)
            for s, g in itertools.product(spans[2:], LIKENESS[2::2])
        },
        **{
            f"wavelet, {name}": {
                f"{rule}, {levels} levels": LiftingDenoiser(
                    name, rule=rule, levels=levels, cycle_spins=8
                )
                for rule, levels in itertools.product(rules, (3, 5))
            }
            for name in ("haar", "linear")
        },
        PUBLISHED: {"": non_local(SIGMA)},
        TUNED: {f"sigma {s:.3f}": non_local(s) for s in LIKENESS},
        "non-local, joints apart": {
            f"sigma {s:.3f}": non_local(s, groups="joint") for s in LIKENESS
        },
    }


def repeated(module: nn.Module, times: int) -> nn.Module:
    """The same filter several times over."""
    return nn.Sequential(*[module] * times)


def corruptions(clean: Tensor, draws: int) -> dict[str, Tensor]:
    """The columns of the table: several draws of every noise, ``(draws, T, J, 4)``."""
    generator = torch.Generator().manual_seed(2016)
    several = clean.expand(draws, *clean.shape)
    noisy = {
        f"{level} sigma": noise.gaussian(several, level * SIGMA, generator=generator)
        for level in LEVELS
    }
    noisy["impulse"] = noise.impulse(several, IMPULSE, share=IMPULSE_SHARE, generator=generator)
    return noisy


def psnr(q: Tensor, clean: Tensor) -> float:
    """Peak signal-to-noise ratio over all draws [dB]."""
    return float(metrics.psnr(q, clean.expand(q.shape)))


def best(settings: dict[str, nn.Module], noisy: Tensor, clean: Tensor) -> Entry:
    """The setting that comes nearest to the clean motion."""
    entries = []
    for setting, module in settings.items():
        with torch.inference_mode():
            q = module(noisy)
        entries.append(Entry(psnr(q, clean), setting, q))
    return max(entries, key=lambda entry: entry.psnr)


def table_1(clean: Tensor, columns: dict[str, Tensor]) -> dict[str, dict[str, Entry]]:
    """Every method on every column."""
    methods = candidates()
    cells = {method: {} for method in methods}
    pairs = list(itertools.product(methods, columns))
    for method, column in tqdm(pairs, unit="cell", disable=None):
        cells[method][column] = best(methods[method], columns[column], clean)
    return cells


def about_ends(clean: Tensor, noisy: Tensor, sigma: float) -> list[str]:
    """How well the ends of the motion come out, by boundary rule."""
    lines = [f"Fig. 4, boundaries ({MEDIUM}): PSNR [dB] of the first and last 10 frames"]
    for boundary in ("replicate", "extrapolate", "reflect", "truncate"):
        q = non_local(sigma, boundary=boundary)(noisy)
        ends = [torch.cat([x[..., :10, :, :], x[..., -10:, :, :]], -3) for x in (q, clean)]
        lines.append(f"  {boundary:<25} {psnr(*ends):5.1f}")
    return lines


def about_edges(clean: Tensor, cells: dict[str, dict[str, Entry]], column: str) -> list[str]:
    """Angular speed and lag of what the filters leave."""
    lines = [f"Fig. 5, {column}: peak angular speed kept, and lag in time [frames]"]
    reference = clean.expand(cells["noisy"][column].q.shape)
    for method in ("noisy", "Gaussian", "bilateral", "wavelet, linear", TUNED):
        q = cells[method][column].q
        kept = float(metrics.peak_speed_kept(q, reference))
        lines.append(f"  {method:<25} {kept:5.2f}   {lag(q, clean):+5.2f}")
    return lines


def lag(q: Tensor, clean: Tensor, reach: int = 4) -> float:
    """Shift at which the motion is nearest to the clean one [frames], > 0 for late ones."""
    frames = clean.shape[-3] - 2 * reach
    inner = q.narrow(-3, reach, frames)
    errors = [
        float(metrics.mean_squared_error(inner, clean.narrow(-3, start, frames).expand_as(inner)))
        for start in range(2 * reach + 1)
    ]
    lowest = min(max(errors.index(min(errors)), 1), 2 * reach - 1)
    before, here, after = errors[lowest - 1 : lowest + 2]  # a parabola through three points
    return reach - lowest - 0.5 * (before - after) / (before - 2.0 * here + after)


def about_windows(clean: Tensor, noisy: Tensor) -> list[str]:
    """How the size of the search window matters, sigma tuned for each."""
    radii = (5, 10, 20, 40, 80)
    found = [
        best({f"{s}": non_local(s, search_radius=r) for s in LIKENESS}, noisy, clean) for r in radii
    ]
    sizes = "  ".join(f"{2 * r + 1:>4}" for r in radii)
    values = "  ".join(f"{entry.psnr:4.1f}" for entry in found)
    return [f"Search window ({MEDIUM}) [poses], PSNR [dB]", f"  {sizes}", f"  {values}"]


def about_sums(clean: Tensor, noisy: Tensor) -> list[str]:
    """What becomes of the weights of eq. 3 if the squared differences are summed, as printed."""
    width = 2 * PATCH_RADIUS + 1
    lines = [
        f"Eq. 3 with the sum of all {width * clean.shape[-2] * 3} squared differences of a patch, "
        "weight of the frame next door:"
    ]
    for label, q in (("clean", clean), ("1 sigma", noisy[0])):
        square = metrics.angular_velocity(q).square().sum((-1, -2))
        summed = square.unfold(0, width, 1).sum(-1)
        exponent = float(summed.median()) / (2.0 * SIGMA**2) / math.log(10.0)
        lines.append(f"  {label:<25} 10^-{exponent:.0f}")
    return lines


def reproduce(motion: Motion, folder: Path, draws: int = 3) -> list[str]:
    """Write all figures; returns what they show, line by line."""
    motion = moving_joints(motion)
    clean = motion.q
    columns = corruptions(clean, draws)
    cells = table_1(clean, columns)
    first = {c: {method: cells[method][c].q[0] for method in cells} for c in columns}
    channel = widest_channel(clean)
    all_channels = {
        "ground truth": clean,
        "noisy, 15 sigma": first[MEDIUM]["noisy"],
        "non-local pose means": first[MEDIUM][TUNED],
    }
    figure_4(all_channels, motion.frame_rate, folder / "fig4.png")
    one_channel = {c: (first[c]["noisy"], first[c][TUNED]) for c in ("1 sigma", MEDIUM, "75 sigma")}
    figure_5(clean, one_channel, channel, folder / "fig5.png")
    overlaid = {c: {m: first[c][m] for m in OVERLAID} for c in ("1 sigma", "30 sigma")}
    figure_6(clean, overlaid, channel, folder / "fig6.png")
    sigma = float(cells[TUNED][MEDIUM].setting.split()[-1])
    return [
        *_about_table(cells),
        *about_ends(clean, columns[MEDIUM], sigma),
        *about_edges(clean, cells, MEDIUM),
        *about_windows(clean, columns[MEDIUM]),
        *about_sums(clean, columns["1 sigma"]),
    ]


def _about_table(cells: dict[str, dict[str, Entry]]) -> list[str]:
    columns = list(cells["noisy"])
    lines = ["Table I, PSNR [dB]" + " " * 9 + "".join(f"{column:>10}" for column in columns)]
    for method, row in cells.items():
        values = "".join(f"{entry.psnr:10.1f}" for entry in row.values())
        lines.append(f"  {method:<25}{values}")
    lines.append("Settings of the table:")
    for method, row in cells.items():
        if any(entry.setting for entry in row.values()):
            settings = "; ".join(entry.setting for entry in row.values())
            lines.append(f"  {method:<25} {settings}")
    return lines


def _reproduce(arguments: jsonargparse.Namespace) -> int:
    clip, skip = arguments.clip, arguments.skip
    if clip is None and CMU_CLIP.exists():
        clip, skip = CMU_CLIP, T_POSE
    motion = synthetic_run() if clip is None else middle(clip, arguments.frames, skip=skip)
    name = "synthetic run" if clip is None else clip.name
    print(f"{name}: {len(motion.q)} frames at {motion.frame_rate:g} fps")
    print(*reproduce(motion, arguments.output, arguments.draws), sep="\n")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Write the figures; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Redo Table I and Fig. 4 to 6 of Dean.", exit_on_error=False
    )
    parser.add_argument("--output", type=Path, default=Path("out/dean"), help="a folder")
    parser.add_argument("--clip", type=Path, default=None, help="motion file")
    parser.add_argument("--skip", type=int, default=0, help="leading frames that are no motion")
    parser.add_argument("--frames", type=int, default=300, help="from the middle of the clip")
    parser.add_argument("--draws", type=int, default=3, help="of every noise")
    return run(parser, argv, _reproduce)


if __name__ == "__main__":
    sys.exit(main())
