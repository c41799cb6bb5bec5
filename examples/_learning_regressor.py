"""A filter inside a larger net: a toy regressor of poses, as a video estimator would be.

Each frame is seen by itself, through a fixed random mixture of all joints and noise. What the net
puts out jitters, and a filter behind it takes part in training: the loss comes after it, and its
gradients reach the net through it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from _learning_data import Data, Figures, judged
from _learning_jobs import LIKENESS, RADIUS, SPANS, best
from _learning_loop import Job, fit
from torch import Tensor, nn

from torchquat import BilateralFilter, convert

__all__ = ["Regressor", "regressors"]

FEATURES, HIDDEN = 192, 128
BLUR = 0.15  # noise of a feature; the features themselves vary by about 0.5
STEPS, RATE = 600, 2e-3
BY_HAND, INSIDE = "regressor, then filter by hand", "regressor, filter inside, learned"


class Camera:
    """Features ``(..., T, F)`` of poses: a random mixture of their matrices' entries, and noise.

    Args:
        data: For the number of joints, and the draws.
    """

    def __init__(self, data: Data) -> None:
        entries = 6 * data.joints
        draw = data.generator(-2)
        self.mixture = torch.randn(entries, FEATURES, generator=draw) / entries**0.5
        self.data = data

    def __call__(self, q: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Look at ``(..., T, J, 4)``; without a generator with the draw that is judged by."""
        generator = self.data.generator(-1) if generator is None else generator
        seen = convert(q, "quat_xyzw", "rot6d").flatten(-2) @ self.mixture
        return seen + BLUR * torch.randn(seen.shape, generator=generator)

    def pairs(self, step: int) -> tuple[Tensor, Tensor]:
        """Features and clean rotations of one step."""
        generator = self.data.generator(step)
        clean = self.data.clean(generator)
        return self(clean, generator), clean


class Regressor(nn.Module):
    """From features ``(..., T, F)`` to unit quaternions ``(..., T, J, 4)``, frame by frame."""

    def __init__(self, joints: int) -> None:
        super().__init__()
        self.joints = joints
        self.straight = nn.Linear(FEATURES, 6 * joints)
        self.bent = nn.Sequential(
            nn.Linear(FEATURES, HIDDEN), nn.GELU(), nn.Linear(HIDDEN, 6 * joints)
        )

    def forward(self, features: Tensor) -> Tensor:
        """Regress two columns of every matrix."""
        columns = self.straight(features) + self.bent(features)
        return convert(columns.unflatten(-1, (self.joints, 6)), "rot6d", "quat_xyzw")


def regressors(
    data: Data, folder: Path, *, resume: bool, scale: float, every: int
) -> Iterator[tuple[str, Figures]]:
    """Rows of the table: alone, with a filter after training, with one inside."""
    camera = Camera(data)
    steps = max(round(scale * STEPS), 1)

    def learned(name: str, module: nn.Module) -> nn.Module:
        job = Job(name, module, camera.pairs, steps, RATE, data.seed)
        fit(job, folder, resume=resume, every=every)
        return module

    def row(module: nn.Module) -> Figures:
        return judged(module, data, data.unseen, camera)

    alone = learned("regressor", _new(data))
    yield "regressor", row(alone)

    def followed(**setting) -> nn.Module:
        return nn.Sequential(alone, BilateralFilter(**setting, radius=RADIUS))

    setting = best(followed, data, camera, sigma_t=SPANS, sigma_g=LIKENESS)
    yield BY_HAND, row(followed(**setting))
    each: dict[str, Any] = {name: [value] * data.joints for name, value in setting.items()}
    inside = nn.Sequential(_new(data), BilateralFilter(**each, radius=RADIUS, learnable=True))
    yield INSIDE, row(learned("regressor_filter_inside", inside))


def _new(data: Data) -> Regressor:
    torch.manual_seed(data.seed)
    return Regressor(data.joints)
