"""Filters that are set by hand, and the same ones learned.

By hand means: of a grid of settings, the one with the highest PSNR on noisy copies of the clips
that the others learn from. Learning starts there.
"""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from _learning_data import Clip, Data, Method, judged, middle_of
from _learning_loop import Job, fit
from torch import Tensor, nn

from torchquat import (
    BilateralFilter,
    LearnedPredict,
    LearnedUpdate,
    LiftingDenoiser,
    LiftingStep,
    NonLocalPoseMeans,
    PatchEmbedding,
)

__all__ = ["Learn", "bandwidths", "best", "blocks", "learner"]

RADIUS = 12  # of the bilateral filter's window, for all settings [frames]
SPANS = (1.0, 1.5, 2.0, 3.0, 4.0)  # [frames]
LIKENESS = (0.1, 0.2, 0.4, 0.8, 1.6)  # [rad]
MULTIPLES = (2.0, 3.0, 4.5, 6.5, 10.0)  # of each joint's noise
RULES = ("universal", "sure", "bayes")
LEVELS = (2, 3, 4, 5)
PATCH_LIKENESS = (0.02, 0.04, 0.06, 0.08, 0.12, 0.16)  # [rad]
QUICK_STEP = 7  # where it is to be quick, one setting of so many is tried
PATCH: dict[str, Any] = {"patch_radius": 5, "search_radius": 10}

Learn = Callable[[str, nn.Module, int, float], nn.Module]
"""Trains a module, by name, for so many steps from this rate on, and returns it."""


def learner(data: Data, folder: Path, *, resume: bool, scale: float, every: int) -> Learn:
    """How all filters on rotations learn; ``scale`` multiplies the numbers of steps."""

    def learn(name: str, module: nn.Module, steps: int, rate: float) -> nn.Module:
        job = Job(name, module, data.pairs, max(round(scale * steps), 1), rate, data.seed)
        fit(job, folder, resume=resume, every=every)
        return module

    return learn


def bandwidths(data: Data, learn: Learn) -> Iterator[tuple[str, nn.Module]]:
    """Bandwidths of the bilateral filter and thresholds of the wavelet: rows of the table."""
    one = best(_bilateral, data, sigma_t=SPANS, sigma_g=LIKENESS)
    yield "bilateral, by hand", _bilateral(**one)
    yield "bilateral, learned", learn("bilateral", _bilateral(**one, learnable=True), 150, 0.03)
    by_noise = _bilateral_by_noise(data.sigma)
    each = best(by_noise, data, sigma_t=SPANS, multiple=MULTIPLES)
    yield "bilateral per joint, by hand", by_noise(**each)
    module = by_noise(**each, learnable=True)
    yield "bilateral per joint, learned", learn("bilateral_per_joint", module, 300, 0.03)
    rule = best(LiftingDenoiser, data, rule=RULES, levels=LEVELS)
    yield "lifting, by hand", LiftingDenoiser(**rule)
    thresholds = LiftingDenoiser(**rule, learnable=True)
    yield "lifting, thresholds learned", learn("lifting_thresholds", thresholds, 150, 0.03)


def blocks(data: Data, learn: Learn) -> Iterator[tuple[str, nn.Module]]:
    """Learned lifting steps and patch features: rows of the table."""
    rule = best(LiftingDenoiser, data, rule=RULES, levels=LEVELS)
    torch.manual_seed(data.seed)
    steps = [LiftingStep(LearnedPredict(), LearnedUpdate()) for _ in range(rule["levels"])]
    learned = LiftingDenoiser(steps, rule=rule["rule"], learnable=True)
    yield "lifting, by hand", LiftingDenoiser(**rule)
    yield "lifting, blocks learned", learn("lifting_blocks", learned, 400, 0.01)
    found = best(_nonlocal, data, sigma=PATCH_LIKENESS, groups=("pose", "joint"))
    yield "non-local, by hand", _nonlocal(**found)
    yield "non-local, learned", learn("nonlocal", _nonlocal(**found, learnable=True), 150, 0.03)
    torch.manual_seed(data.seed)
    features = PatchEmbedding(PATCH["patch_radius"], joints=data.joints)
    embedded = _nonlocal(**found, embedding=features, learnable=True)
    yield "non-local, features learned", learn("nonlocal_features", embedded, 300, 0.02)


def best(
    make: Callable[..., Method], data: Data, spoil: Method | None = None, **choices: tuple
) -> dict[str, Any]:
    """The setting with the highest mean PSNR on spoilt copies of the clips to learn from."""
    settings = [
        dict(zip(choices, values, strict=True)) for values in itertools.product(*choices.values())
    ]
    clips = [Clip(clip.name, middle_of(clip.q)) for clip in data.trained]
    settings = settings[:: QUICK_STEP if data.quick else 1]
    return max(settings, key=lambda one: float(judged(make(**one), data, clips, spoil).psnr.mean()))


def _bilateral(**setting) -> BilateralFilter:
    return BilateralFilter(**setting, radius=RADIUS)


def _bilateral_by_noise(sigma: Tensor) -> Callable[..., BilateralFilter]:
    """Every joint's geodesic bandwidth is a multiple of its noise, which is known here."""

    def make(sigma_t: float, multiple: float, learnable: bool = False) -> BilateralFilter:
        spans = [sigma_t] * len(sigma)
        return _bilateral(sigma_t=spans, sigma_g=(multiple * sigma).tolist(), learnable=learnable)

    return make


def _nonlocal(**setting) -> NonLocalPoseMeans:
    return NonLocalPoseMeans(**setting, **PATCH)
