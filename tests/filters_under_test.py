"""The grid: all filters of the package, and what single ones cannot hold.

A new filter joins every check of the contract by one line here. ``CANNOT`` says which checks do not
hold for it, and why; they are strict expected failures.
"""

import pytest
import torch
from torch import nn

from torchquat import (
    AutoDenoiser,
    BilateralFilter,
    ButterworthFilter,
    GaussianFilter,
    HampelFilter,
    KalmanSmoother,
    KernelPCAFilter,
    LearnedPredict,
    LearnedUpdate,
    LiftingDenoiser,
    LiftingStep,
    LinearFilter,
    LocalSpectrumFilter,
    LowRankFilter,
    MedianFilter,
    MovingMeanFilter,
    NonLocalPoseMeans,
    OneEuroFilter,
    OutlierRepair,
    PatchEmbedding,
    PrincipalComponentFilter,
    SavitzkyGolayFilter,
)


def shaken(module: nn.Module) -> nn.Module:
    """As if trained and then put to use: a new learned block does nothing."""
    draw = torch.Generator().manual_seed(0)
    for parameter in module.requires_grad_(False).parameters():
        parameter += 0.2 * torch.randn(parameter.shape, generator=draw)
    return module


SYMMETRIC: dict[str, nn.Module] = {
    "gaussian": GaussianFilter(1.5),
    "gaussian-truncate": GaussianFilter(1.5, boundary="truncate"),
    "linear": LinearFilter([-0.1, 0.3, 0.6, 0.3, -0.1], boundary="extrapolate"),
    "bilateral": BilateralFilter(1.5, 0.5, iterations=2),
    "bilateral-circular": BilateralFilter(1.5, 0.5, boundary="circular"),
    "bilateral-exponential": BilateralFilter(1.5, 0.5, kernel="exponential"),
    "bilateral-per-joint": BilateralFilter([1.0, 1.5, 2.0], 0.5, boundary="replicate"),
    "nonlocal-joint": NonLocalPoseMeans(0.3, patch_radius=1, search_radius=4, groups="joint"),
    "savitzky-golay": SavitzkyGolayFilter(3, 2),
    "savitzky-golay-reflect": SavitzkyGolayFilter(2, 3, boundary="reflect"),
    "moving-mean": MovingMeanFilter(),
    "butterworth": ButterworthFilter(0.2),
    "butterworth-extrapolate": ButterworthFilter(
        7.0, order=3, frame_rate=30.0, boundary="extrapolate"
    ),
    "median": MedianFilter(2),
    "median-truncate": MedianFilter(1, boundary="truncate"),
    "hampel": HampelFilter(2, 1.0),
    "local-spectrum": LocalSpectrumFilter(),
    "local-spectrum-short": LocalSpectrumFilter(6, sigma=0.2),
    "repair": OutlierRepair(),
}
CAUSAL: dict[str, nn.Module] = {
    "gaussian-causal": GaussianFilter(1.5, causal=True),
    "linear-causal": LinearFilter([1.0, 2.0, 3.0, 0.0, 0.0]),
    "bilateral-causal": BilateralFilter(1.5, 0.5, causal=True, iterations=2),
    "nonlocal-causal": NonLocalPoseMeans(
        0.3, patch_radius=1, search_radius=4, groups="joint", causal=True
    ),
    "one-euro": OneEuroFilter(0.05, 0.2, d_cutoff=0.1),
}
ASYMMETRIC: dict[str, nn.Module] = {
    "linear-asymmetric": LinearFilter([0.1, 0.2, 0.5, 0.3, 0.4]),
    "lifting-haar": LiftingDenoiser("haar", levels=3, rule=0.1),
    "lifting-linear": LiftingDenoiser("linear", shrinkage="garrote"),
    "lifting-squad": LiftingDenoiser("squad", levels=2, rule="sure", cycle_spins=3),
    "lifting-bezier": LiftingDenoiser("bezier", levels=3, rule="bayes"),
    "lifting-finest": LiftingDenoiser("linear", levels=3, rule="finest"),
    "lifting-learned": LiftingDenoiser(
        LiftingStep(shaken(LearnedPredict()), shaken(LearnedUpdate())), levels=2, rule=0.1
    ),
    "kalman": KalmanSmoother(0.1, 0.3),
    "kalman-acceleration": KalmanSmoother(0.05, 0.3, order=3),
}
"""One side counts more than the other, or even frames for something else than odd ones."""
MIXING: dict[str, nn.Module] = {
    "nonlocal-pose": NonLocalPoseMeans(0.3, patch_radius=1, search_radius=4, boundary="reflect"),
    "nonlocal-embedding": NonLocalPoseMeans(
        0.3, patch_radius=1, search_radius=4, embedding=shaken(PatchEmbedding(1))
    ),
    "principal-components": PrincipalComponentFilter(4),
    "principal-components-share": PrincipalComponentFilter(0.8),
    "auto": AutoDenoiser(),
    "low-rank": LowRankFilter(),
    "low-rank-short": LowRankFilter(3, sigma=0.2),
    "kernel-pca": KernelPCAFilter(4),
    "kernel-pca-narrow": KernelPCAFilter(0.8, sigma=0.3, landmarks=8, iterations=4),
}
"""Filters whose joints share weights, on purpose; symmetric in time, but for some."""
ALL = SYMMETRIC | CAUSAL | ASYMMETRIC | MIXING
APART = {name: run for name, run in ALL.items() if name not in MIXING}
"""Filters that treat every joint as if it were alone."""

AHEAD = "reads frames to come"
GIVEN = {
    **dict.fromkeys(
        ("local-spectrum", "local-spectrum-short", "low-rank", "low-rank-short", "auto"),
        "derivatives take gains, axes and the noise as given",
    ),
    "kernel-pca": "derivatives take the width of the kernel as given",
}
CANNOT: dict[str, dict[str, str]] = {
    "B1": {"bilateral-per-joint": "three bandwidths are not for no joints"},
    "C9": {
        **dict.fromkeys(CAUSAL, "the past counts, the future does not"),
        **dict.fromkeys(ASYMMETRIC, "even frames are not odd ones, or one side counts more"),
        "nonlocal-embedding": "its embedding has learned one direction of time",
    },
    "derivatives": GIVEN,
    "second derivatives": GIVEN
    | dict.fromkeys(
        ("principal-components", "principal-components-share", "kernel-pca-narrow"),
        "second derivatives leave out how components turn",
    ),
    "joints": dict.fromkeys(MIXING, "joints of a group share weights, on purpose"),
    "ahead": dict.fromkeys((name for name in ALL if name not in CAUSAL), AHEAD),
}
"""Row of the contract, or what it is about: filters that do not hold it, and the reason."""


def every_filter(row: str) -> pytest.MarkDecorator:
    """Run a test with every filter as ``run``; it must fail for those that cannot pass."""
    return pytest.mark.parametrize(
        "run",
        [
            pytest.param(run, id=name, marks=_marks(CANNOT[row].get(name)))
            for name, run in ALL.items()
        ],
    )


def _marks(reason: str | None) -> list[pytest.MarkDecorator]:
    if reason is None:
        return []
    raises = (AssertionError, ValueError)
    return [pytest.mark.xfail(reason=reason, raises=raises, strict=True)]
