"""What the filters learn from, and what they are judged on: clips, and noise of an estimator."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from _clips import middle, moving_joints, synthetic_run
from _quality_clips import Clip, dropped, paths_of
from torch import Tensor

from torchquat import metrics, noise
from torchquat.io import Motion

__all__ = ["Clip", "Data", "Figures", "Method", "judged", "middle_of", "read"]

RATE = 60  # [frames per second]
WINDOW, BATCH = 64, 8  # frames, windows per step
JUDGED_FRAMES = 300  # at most, of every clip that is judged
QUIETEST, LOUDEST = 0.02, 0.2  # noise per axis [rad]
DRAWS = 3  # of noise, for every clip that is judged
LARGE_PRIME = 1_000_003


@dataclass(frozen=True)
class Data:
    """Clips with the same joints, and the noise of each joint.

    Attributes:
        trained: Whole clips to learn from, float32.
        unseen: Slices of others, to judge by.
        sigma: Noise per axis of every joint ``(J,)`` [rad].
        seed: Of all draws.
        quick: Whether little of everything is wanted.
    """

    trained: list[Clip]
    unseen: list[Clip]
    sigma: Tensor
    seed: int
    quick: bool = False

    @property
    def joints(self) -> int:
        """How many."""
        return len(self.sigma)

    def clean(self, generator: torch.Generator) -> Tensor:
        """Windows ``(B, T, J, 4)`` of the clips to learn from, of each as often as of the others.

        A long clip of one kind of motion would be learned otherwise.
        """
        chosen = torch.randint(len(self.trained), (BATCH,), generator=generator)
        window = min(WINDOW, *(len(clip.q) for clip in self.trained))
        return torch.stack([_slice(self.trained[int(c)].q, window, generator) for c in chosen])

    def spoilt(self, q: Tensor, generator: torch.Generator) -> Tensor:
        """With noise added."""
        return noise.gaussian(q, self.sigma, generator=generator)

    def generator(self, step: int) -> torch.Generator:
        """For the draws of one step; -1 is for what is judged."""
        return torch.Generator().manual_seed(LARGE_PRIME * (self.seed + 1) + step)

    def pairs(self, step: int) -> tuple[Tensor, Tensor]:
        """Noisy and clean windows of one step."""
        generator = self.generator(step)
        clean = self.clean(generator)
        return self.spoilt(clean, generator), clean


@dataclass(frozen=True)
class Figures:
    """How near to the truth a method comes, one number a clip.

    Attributes:
        psnr: [dB].
        kept: Share of the peak angular speed.
    """

    psnr: Tensor
    kept: Tensor


Method = Callable[[Tensor], Tensor]


def judged(method: Method, data: Data, clips: list[Clip], spoil: Method | None = None) -> Figures:
    """Figures of a method.

    Args:
        method: From inputs to rotations ``(DRAWS, T, J, 4)``.
        data: Says what is put on the clips.
        clips: Which.
        spoil: Makes inputs of clean motion; ``None``: noise on the rotations.
    """
    rows = []
    for clip in clips:
        clean = clip.q.expand(DRAWS, *clip.q.shape)
        with torch.no_grad():
            seen = data.spoilt(clean, data.generator(-1)) if spoil is None else spoil(clean)
            made = method(seen)
        rows.append([metrics.psnr(made, clean), metrics.peak_speed_kept(made, clean)])
    psnr, kept = torch.tensor(rows).T
    return Figures(psnr, kept)


def read(folder: Path | None, seed: int, *, quick: bool = False) -> Data:
    """Split clips: of every two of about one length, one to learn from and one to judge by.

    Clips whose joints have other names than those of most clips are left out.

    Args:
        folder: Of BVH files; ``None``: the clips beside the project, or made-up motion.
        seed: Of all draws.
        quick: Made-up motion, little of it, unless a folder is named.

    Raises:
        ValueError: If fewer than two clips have the same joints.
    """
    paths = [] if quick and folder is None else paths_of(folder)
    motions = {path.stem: _loaded(path) for path in paths} or _made_up(quick)
    names = Counter(motion.names for motion in motions.values()).most_common(1)[0][0]
    clips = [
        Clip(name, _of_joints(motion, names))
        for name, motion in motions.items()
        if {*names} <= {*motion.names}
    ]
    if len(clips) < 2:
        raise ValueError(f"clips must be two or more with the same joints, got {len(clips)}.")
    clips.sort(key=lambda clip: -len(clip.q))
    unseen = [Clip(clip.name, middle_of(clip.q)) for clip in clips[1::2]]
    spread = torch.rand(len(names), generator=torch.Generator().manual_seed(seed))
    return Data(clips[::2], unseen, QUIETEST * (LOUDEST / QUIETEST) ** spread, seed, quick)


def middle_of(q: Tensor) -> Tensor:
    """The frames in the middle that are judged."""
    length = min(len(q), JUDGED_FRAMES)
    return q.narrow(0, (len(q) - length) // 2, length)


def _slice(q: Tensor, length: int, generator: torch.Generator) -> Tensor:
    start = torch.randint(len(q) - length + 1, (), generator=generator)
    return q.narrow(0, int(start), length)


def _loaded(path: Path) -> Motion:
    return moving_joints(middle(path, 10**9, frame_rate=RATE, skip=dropped(path)))


def _of_joints(motion: Motion, names: tuple[str, ...]) -> Tensor:
    return motion.q[:, [motion.names.index(name) for name in names]].float()


def _made_up(quick: bool) -> dict[str, Motion]:
    """Runs at different speeds: the slower ones last longer."""
    frames = 60 if quick else 600
    speeds = {"slow": 1.0, "slower": 0.7, "fast": 1.6, "faster": 2.0}
    return {
        name: synthetic_run(round(frames / speed), RATE / speed) for name, speed in speeds.items()
    }
