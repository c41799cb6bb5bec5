"""All filters of the package, as modules, by what they promise."""

from torch import nn

from torchquat import (
    BilateralFilter,
    GaussianFilter,
    LiftingDenoiser,
    LinearFilter,
    NonLocalPoseMeans,
    OutlierRepair,
)

SYMMETRIC: dict[str, nn.Module] = {
    "gaussian": GaussianFilter(1.5),
    "gaussian-truncate": GaussianFilter(1.5, boundary="truncate"),
    "linear": LinearFilter([-0.1, 0.3, 0.6, 0.3, -0.1], boundary="extrapolate"),
    "bilateral": BilateralFilter(1.5, 0.5, iterations=2),
    "bilateral-circular": BilateralFilter(1.5, 0.5, boundary="circular"),
    "bilateral-exponential": BilateralFilter(1.5, 0.5, kernel="exponential"),
    "bilateral-per-joint": BilateralFilter([1.0, 1.5, 2.0], 0.5, boundary="replicate"),
    "nonlocal-joint": NonLocalPoseMeans(0.3, patch_radius=1, search_radius=4, groups="joint"),
    "repair": OutlierRepair(),
}
CAUSAL: dict[str, nn.Module] = {
    "gaussian-causal": GaussianFilter(1.5, causal=True),
    "linear-causal": LinearFilter([1.0, 2.0, 3.0, 0.0, 0.0]),
    "bilateral-causal": BilateralFilter(1.5, 0.5, causal=True, iterations=2),
    "nonlocal-causal": NonLocalPoseMeans(
        0.3, patch_radius=1, search_radius=4, groups="joint", causal=True
    ),
}
ASYMMETRIC: dict[str, nn.Module] = {
    "linear-asymmetric": LinearFilter([0.1, 0.2, 0.5, 0.3, 0.4]),
    "lifting-haar": LiftingDenoiser("haar", levels=3, rule=0.1),
    "lifting-linear": LiftingDenoiser("linear", shrinkage="garrote"),
    "lifting-squad": LiftingDenoiser("squad", levels=2, rule="sure", cycle_spins=3),
    "lifting-bezier": LiftingDenoiser("bezier", levels=3, rule="bayes"),
    "lifting-finest": LiftingDenoiser("linear", levels=3, rule="finest"),
}
"""One side counts more than the other, or even frames for something else than odd ones."""
MIXING: dict[str, nn.Module] = {
    "nonlocal-pose": NonLocalPoseMeans(0.3, patch_radius=1, search_radius=4, boundary="reflect"),
}
"""Filters whose joints share weights, on purpose; symmetric in time."""
ALL = SYMMETRIC | CAUSAL | ASYMMETRIC | MIXING
APART = {name: run for name, run in ALL.items() if name not in MIXING}
"""Filters that treat every joint as if it were alone."""
