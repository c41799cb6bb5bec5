"""Redo Fig. 5 to 11 of Szczesna, Slupik and Janiak, "Quaternion Lifting Scheme", ICONS 2012.

python examples/reproduce_szczesna2012.py [--output FOLDER] [--clip MOTION.bvh --joint LeftUpLeg]

Writes fig5.png to fig11.png and prints the figures behind them. The paper's motion is not public: a
clip of the CMU database stands for it where it lies beside the project, and a synthetic run
elsewhere. Angles are Euler angles in degrees, as in the paper.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import jsonargparse
import roma
import torch
from _clips import CMU, middle, synthetic_run
from _command import run
from _figures import plt, save
from torch import Tensor

from torchquat import (
    LiftingStep,
    LiftingTransform,
    LinearPredict,
    LinearUpdate,
    Pyramid,
    lifting_denoiser,
    metrics,
    noise,
    so3,
)
from torchquat.filters.lifting import WAVELETS, Wavelet
from torchquat.io import Motion

CMU_CLIP = CMU / "01_01.bvh"
FRAMES = 600  # as in the paper
LEVELS = 4
NOISE_DEG = 0.5  # per axis: gives details of the size that Fig. 10 shows
ZEROED = 2  # finest levels
SCHEMES: tuple[Wavelet, ...] = ("haar", "linear")


def euler(q: Tensor) -> Tensor:
    """Angles about y, x and z ``(T, 3)`` [deg] of the rotations of one joint ``(T, 1, 4)``."""
    angles = roma.unitquat_to_euler("YXZ", q[:, 0], degrees=True)
    assert isinstance(angles, Tensor)  # for the type checker: as_tuple is off
    return angles


def figure_level(title: str, q: Tensor, detail: Tensor, path: Path) -> None:
    """One level of resolution: Euler angles of the motion, and of the details."""
    _plot_columns(title, {"data": euler(q), "details": euler(so3.exp(detail))}, path)


def _plot_columns(title: str, columns: dict[str, Tensor], path: Path) -> None:
    """Angles about y, x and z below each other, one column a signal ``(T, 3)`` [deg]."""
    figure, axes = plt.subplots(3, len(columns), figsize=(5.5 * len(columns), 6.5), squeeze=False)
    for column, (label, angles) in enumerate(columns.items()):
        for row, axis in enumerate("yxz"):
            ax = axes[row, column]
            ax.plot(angles[:, row], linewidth=0.9, color="#2a6f97")
            ax.set_ylabel(f"{axis} [deg]")
        axes[0, column].set_title(label, fontsize=10)
        axes[-1, column].set_xlabel("frame of this level")
    figure.suptitle(title, fontsize=11)
    save(figure, path)


def draw_levels(clean: Tensor, folder: Path) -> dict[str, Pyramid]:
    """Fig. 5 to 8: levels one and four of both schemes; returns their pyramids."""
    pyramids = {}
    for number, name in zip((5, 7), SCHEMES, strict=True):
        for level, offset in ((1, 0), (LEVELS, 1)):
            pyramid = LiftingTransform(name, levels=level)(clean)
            title = f"Fig. {number + offset}: level {level} of the {name} scheme"
            path = folder / f"fig{number + offset}.png"
            figure_level(title, pyramid.approx, pyramid.details[0], path)
            pyramids[name] = pyramid
    return pyramids


def draw_denoising(clean: Tensor, noisy: Tensor, folder: Path) -> dict[str, Tensor]:
    """Fig. 9 to 11: noisy motion, its finest details, denoised motions, which are returned."""
    _plot_columns(
        "Fig. 9: with noise", {"noisy": euler(noisy), "original": euler(clean)}, folder / "fig9.png"
    )
    details = {
        label: euler(so3.exp(LiftingTransform("linear", levels=1)(q).details[0]))
        for label, q in (("of the noisy motion", noisy), ("of the original", clean))
    }
    _plot_columns("Fig. 10: finest details, linear scheme", details, folder / "fig10.png")
    denoised = {
        name: lifting_denoiser(noisy, wavelet=name, levels=ZEROED, rule="finest")
        for name in WAVELETS
    }
    shown = {name: euler(denoised[name]) for name in SCHEMES}
    _plot_columns(f"Fig. 11: {ZEROED} finest levels set to zero", shown, folder / "fig11.png")
    return denoised


def about_levels(pyramids: dict[str, Pyramid]) -> list[str]:
    """Root mean square of the details."""
    lines = ["Fig. 5 to 8, details [deg, root mean square], levels 1 to 4:"]
    for name, pyramid in pyramids.items():
        sizes = [detail.square().sum(-1).mean().sqrt() for detail in reversed(pyramid.details)]
        shown = "  ".join(f"{float(torch.rad2deg(size)):6.2f}" for size in sizes)
        lines.append(f"  {name:<12} {shown}")
    return lines


def about_denoising(clean: Tensor, noisy: Tensor, denoised: dict[str, Tensor]) -> list[str]:
    """Errors of the paper's denoising, and of a threshold found from the noise."""
    outputs = {"noisy": noisy, **denoised}
    outputs["linear, bayes"] = lifting_denoiser(noisy, rule="bayes", cycle_spins=8)
    lines = ["Fig. 9 to 11, error [deg, root mean square] and PSNR [dB]:"]
    for name, q in outputs.items():
        error = float(metrics.geodesic_rmse_deg(q, clean))
        lines.append(f"  {name:<14} {error:6.3f}   {float(metrics.psnr(q, clean)):5.1f}")
    return lines


def about_print(clean: Tensor) -> list[str]:
    """The printed inverse, and the printed update, against those that are used here."""
    step = LiftingStep(LinearPredict(), LinearUpdate())
    coarse, detail = step(clean)
    right = step.inverse(coarse, detail)
    printed = LiftingStep(LinearPredict(), _Flipped()).inverse(coarse, detail)
    halfway = so3.log(so3.slerp(so3.exp(detail[:-1]), so3.exp(detail[1:]), 0.5)) / 2.0
    ours = LinearUpdate()(detail)[1 : len(detail)]
    apart = torch.rad2deg((halfway - ours).norm(dim=-1).max())
    return [
        "Section V.C, the linear scheme there and back, largest error [deg]:",
        f"  exponent -0.5        {_largest_deg(right, clean):.1e}",
        f"  exponent 0.5 (print) {_largest_deg(printed, clean):.1e}",
        f"  update by slerp of the details instead of their sum: steps differ by {apart:.1e}",
    ]


class _Flipped(LinearUpdate):
    """What the printed inverse amounts to: the update is done once more instead of undone."""

    def forward(self, detail: Tensor) -> Tensor:
        return -super().forward(detail)


def about_means(clean: Tensor) -> list[str]:
    """How far the mean of the coarse motion lies from that of the motion."""
    lines = [f"Section V, mean of level {LEVELS} against mean of the motion [deg]:"]
    whole = karcher_mean(clean)
    for name in WAVELETS:
        coarse = karcher_mean(LiftingTransform(name, levels=LEVELS)(clean).approx)
        lines.append(f"  {name:<12} {_largest_deg(coarse, whole):.4f}")
    every = karcher_mean(clean[:: 2**LEVELS])
    lines.append(f"  every {2**LEVELS}th frame instead: {_largest_deg(every, whole):.4f}")
    return lines


def karcher_mean(q: Tensor, iterations: int = 10) -> Tensor:
    """Mean over time ``(1, J, 4)``: the point to which all log maps add up to nothing."""
    mean = q[:1]
    for _ in range(iterations):
        mean = so3.turn(mean, so3.between(mean, q).mean(0, keepdim=True))
    return mean


def _largest_deg(q: Tensor, reference: Tensor) -> float:
    return float(torch.rad2deg(so3.distance(q, reference).max()))


def reproduce(motion: Motion, joint: str, folder: Path) -> list[str]:
    """Write all figures; returns what they show, line by line."""
    if joint not in motion.names:
        raise ValueError(f"joint must be one of {list(motion.names)}, got {joint!r}.")
    place = motion.names.index(joint)
    clean = motion.q[:, place : place + 1]
    generator = torch.Generator().manual_seed(2012)
    noisy = noise.gaussian(clean, math.radians(NOISE_DEG), generator=generator)
    pyramids = draw_levels(clean, folder)
    denoised = draw_denoising(clean, noisy, folder)
    return [
        *about_levels(pyramids),
        *about_denoising(clean, noisy, denoised),
        *about_means(clean),
        *about_print(clean),
    ]


def _reproduce(arguments: jsonargparse.Namespace) -> int:
    clip: Path | None = arguments.clip
    if clip is None and CMU_CLIP.exists():
        clip = CMU_CLIP
    motion = synthetic_run(FRAMES) if clip is None else middle(clip, FRAMES, skip=arguments.skip)
    name = "synthetic run" if clip is None else clip.name
    print(f"{name}: {len(motion.q)} frames at {motion.frame_rate:g} fps, joint {arguments.joint}")
    print(*reproduce(motion, arguments.joint, arguments.output), sep="\n")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Write the figures; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Redo Fig. 5 to 11 of Szczesna et al. 2012.", exit_on_error=False
    )
    parser.add_argument("--output", type=Path, default=Path("out/szczesna2012"), help="a folder")
    parser.add_argument("--clip", type=Path, default=None, help="motion file")
    parser.add_argument("--skip", type=int, default=0, help="leading frames that are no motion")
    parser.add_argument("--joint", default="LeftUpLeg", help="whose rotation is shown")
    return run(parser, argv, _reproduce)


if __name__ == "__main__":
    sys.exit(main())
