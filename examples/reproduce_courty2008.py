"""Redo the figures of Courty, "Bilateral Human Motion Filtering", EUSIPCO 2008.

python examples/reproduce_courty2008.py [--output FOLDER] [--clip MOTION.bvh --joint RightHand]

Writes fig2.png, fig3.png and fig4.png and prints the figures behind them. The paper's sign language
clip is not public: a clip of the CMU database stands for it where it lies beside the project, and a
synthetic arm elsewhere.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import jsonargparse
import torch
from _clips import CMU, middle, synthetic_arm
from _command import run
from _figures import plt, save
from torch import Tensor
from tqdm import tqdm

from torchquat import Skeleton, bilateral_filter, gaussian_filter, metrics, noise, so3
from torchquat.io import Motion

CMU_CLIP = CMU / "05_03.bvh"
NOISE, SIGMA_T, PASSES = 0.18, 1.0, 5  # as in the paper
PUBLISHED = 0.1
AS_VARIANCE = math.sqrt(PUBLISHED)
"""The paper calls 0.1 a variance: read so, this is the bandwidth."""
SIGMAS_G = (0.05, PUBLISHED, 0.2, AS_VARIANCE, 0.5, 1.0)
FRAMES = 150  # about as many as in the paper


def courty(q: Tensor, sigma_g: float, passes: int = PASSES) -> Tensor:
    """The paper's filter, kernel as printed."""
    return bilateral_filter(
        q, sigma_t=SIGMA_T, sigma_g=sigma_g, kernel="exponential", iterations=passes
    )


def gaussian(q: Tensor, passes: int = PASSES) -> Tensor:
    """The filter the paper compares with."""
    for _ in range(passes):
        q = gaussian_filter(q, sigma_t=SIGMA_T)
    return q


def figure_2(clean: Tensor, noisy: Tensor, frame_rate: float, path: Path) -> None:
    """Components and angular speed of one joint: original, noisy, Gaussian, bilateral."""
    signals = {
        "(a) original": clean,
        "(d) with Gaussian noise, 0.18 rad": noisy,
        f"(b) Gaussian, {PASSES} passes": gaussian(noisy),
        f"(c) bilateral, sigma_g = {PUBLISHED}, {PASSES} passes": courty(noisy, PUBLISHED),
        f"(c') bilateral, sigma_g = {AS_VARIANCE:.3f} (variance 0.1)": courty(noisy, AS_VARIANCE),
    }
    figure, axes = plt.subplots(len(signals), 2, figsize=(12, 11), sharex=True, sharey="col")
    time = torch.arange(len(clean)) / frame_rate
    original = _speed(clean, frame_rate)
    for (left, right), (title, q) in zip(axes, signals.items(), strict=True):
        left.plot(time, so3.align(q, clean)[:, 0], label=list("xyzw"), linewidth=1.1)
        left.set_title(title, fontsize=10)
        right.plot(time[1:], original, color="0.6", label="original", linewidth=1.8)
        if q is not clean:
            right.plot(time[1:], _speed(q, frame_rate), label="this", linewidth=0.9)
        # the noise alone would set the scale
        right.set_ylim(0, 3.0 * float(original.max()))
        right.set_title("angular speed [rad/s]", fontsize=10)
    axes[0, 0].legend(ncols=4, fontsize=8, loc="lower left")
    axes[1, 1].legend(ncols=2, fontsize=8, loc="upper right")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    save(figure, path)


def figure_3(clean: Tensor, noisy: Tensor, path: Path, passes: int = 15) -> dict[str, list[float]]:
    """Mean squared error over the passes for several bandwidths; returns the curves [rad^2]."""
    curves = {}
    for sigma_g in tqdm(SIGMAS_G, unit="curve", disable=None):
        curves[f"bilateral, sigma_g = {sigma_g:.3g}"] = [
            float(metrics.mean_squared_error(courty(noisy, sigma_g, n), clean))
            for n in range(passes + 1)
        ]
    curves["Gaussian"] = [
        float(metrics.mean_squared_error(gaussian(noisy, n), clean)) for n in range(passes + 1)
    ]
    figure, ax = plt.subplots(figsize=(8, 5))
    for label, curve in curves.items():
        ax.plot(curve, label=label, marker=".", color="0.3" if label == "Gaussian" else None)
    ax.axvline(PASSES, color="0.8", zorder=0)
    ax.set(xlabel="passes", ylabel="mean squared error [rad$^2$]", yscale="log")
    ax.legend(fontsize=8, loc="center right", bbox_to_anchor=(1.0, 0.62))
    save(figure, path)
    return curves


def figure_4(
    skeleton: Skeleton, joint: int, motions: dict[str, Tensor], path: Path
) -> dict[str, Tensor]:
    """Path of one joint in space; returns the positions ``(T, 3)``."""
    paths = {}
    for label, q in motions.items():
        root = torch.zeros(len(q), 3)  # the body stays, the limbs move
        paths[label] = skeleton.forward_kinematics(q, root)[1][:, joint]
    across, up = _widest_plane(next(iter(paths.values())))
    figure, axes = plt.subplots(1, len(paths), figsize=(13, 2.9), sharex=True, sharey=True)
    for ax, (label, track) in zip(axes, paths.items(), strict=True):
        ax.plot(track @ across, track @ up, linewidth=0.9, color="#c44e52")
        ax.set_title(label, fontsize=9)
        ax.set_aspect("equal")
    save(figure, path)
    return paths


def reproduce(motion: Motion, joint: str, folder: Path) -> list[str]:
    """Write all figures; returns what they show, line by line."""
    if motion.skeleton is None:
        raise ValueError("the clip must have a skeleton.")
    (index,) = motion.skeleton.index([joint])
    # one joint of the clip for Fig. 2 and 3: its orientation in space, as a sensor would see it
    world, _ = motion.skeleton.forward_kinematics(motion.q)
    clean = world[:, [index]]
    draws = torch.Generator().manual_seed(2008)
    noisy = noise.gaussian(clean, NOISE, generator=draws)
    figure_2(clean, noisy, motion.frame_rate, folder / "fig2.png")
    curves = figure_3(clean, noisy, folder / "fig3.png")

    noisy_pose = noise.gaussian(motion.q, NOISE, generator=draws)
    motions = {
        "(a) original": motion.q,
        "(b) noisy": noisy_pose,
        "(c) Gaussian": gaussian(noisy_pose),
        "(d) bilateral, sigma_g = 0.1": courty(noisy_pose, PUBLISHED),
        f"(d') bilateral, sigma_g = {AS_VARIANCE:.3f}": courty(noisy_pose, AS_VARIANCE),
    }
    paths = figure_4(motion.skeleton, index, motions, folder / "fig4.png")
    return [*_about_speed(clean, noisy), *_about_error(curves), *_about_paths(paths)]


def _about_speed(clean: Tensor, noisy: Tensor) -> list[str]:
    lines = ["Fig. 2, angular speed (peak as a share of the original's, correlation with it):"]
    for label, q in (
        ("noisy", noisy),
        ("Gaussian", gaussian(noisy)),
        *((f"bilateral, sigma_g = {s:.3g}", courty(noisy, s)) for s in (PUBLISHED, AS_VARIANCE)),
    ):
        alike = torch.corrcoef(torch.stack([_speed(q), _speed(clean)]))[0, 1]
        peak = float(metrics.peak_speed_kept(q, clean))
        lines.append(f"  {label:<28} peak {peak:6.2f}   correlation {float(alike):5.2f}")
    return lines


def _about_error(curves: dict[str, list[float]]) -> list[str]:
    lines = ["Fig. 3, mean squared error [rad^2] after 0, 1, 5 and 15 passes, and the best pass:"]
    for label, curve in curves.items():
        shown = " ".join(f"{curve[n]:.4f}" for n in (0, 1, PASSES, 15))
        lines.append(f"  {label:<28} {shown}   {curve.index(min(curve))}")
    return lines


def _about_paths(paths: dict[str, Tensor]) -> list[str]:
    lines = ["Fig. 4, path of the joint (error and spread as a share of the original's spread):"]
    original = next(iter(paths.values()))
    spread = float((original - original.mean(0)).norm(dim=-1).square().mean().sqrt())
    for label, track in paths.items():
        error = float((track - original).norm(dim=-1).square().mean().sqrt()) / spread
        kept = float((track - track.mean(0)).norm(dim=-1).square().mean().sqrt()) / spread
        lines.append(f"  {label:<28} error {error:5.1%}   spread {kept:5.1%}")
    return lines


def _speed(q: Tensor, frame_rate: float = 1.0) -> Tensor:
    """Angular speed of the first joint ``(T - 1,)``."""
    return metrics.angular_velocity(q, frame_rate=frame_rate)[:, 0].norm(dim=-1)


def _widest_plane(track: Tensor) -> tuple[Tensor, Tensor]:
    """Two directions that a path ``(T, 3)`` spreads most along."""
    axes = torch.linalg.svd(track - track.mean(0), full_matrices=False).Vh
    return axes[0], axes[1]


def _reproduce(arguments: jsonargparse.Namespace) -> int:
    clip: Path | None = arguments.clip
    if clip is None and CMU_CLIP.exists():
        clip = CMU_CLIP
    motion = synthetic_arm() if clip is None else middle(clip, FRAMES, frame_rate=60.0)
    name = "synthetic arm" if clip is None else clip.name
    print(f"{name}: {len(motion.q)} frames at {motion.frame_rate:g} fps, joint {arguments.joint}")
    print(*reproduce(motion, arguments.joint, arguments.output), sep="\n")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Write the figures; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Redo the figures of Courty 2008.", exit_on_error=False
    )
    parser.add_argument("--output", type=Path, default=Path("out/courty2008"), help="a folder")
    parser.add_argument("--clip", type=Path, default=None, help="motion file with a skeleton")
    parser.add_argument("--joint", default="RightHand", help="whose rotation and path are shown")
    return run(parser, argv, _reproduce)


if __name__ == "__main__":
    sys.exit(main())
