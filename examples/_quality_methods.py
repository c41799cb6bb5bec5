"""The methods that the benchmark of quality compares, each with the settings to choose from."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from _wrong_ways import (
    components,
    integrated_increments,
    logs_at_identity,
    nine_entries,
    rotation_vectors,
)
from torch import Tensor, nn

import torchquat
from torchquat import (
    BilateralFilter,
    ButterworthFilter,
    GaussianFilter,
    HampelFilter,
    KalmanSmoother,
    KernelPCAFilter,
    LiftingDenoiser,
    MedianFilter,
    MovingMeanFilter,
    NonLocalPoseMeans,
    OneEuroFilter,
    PrincipalComponentFilter,
    SavitzkyGolayFilter,
)

__all__ = ["KINDS", "NOISY", "Method", "methods"]

Denoise = Callable[[Tensor], Tensor]
NOISY = "noisy"
KINDS = {
    "input": "as it came",
    "wrong": "wrong ways, tuned",
    "usual": "usual filters on the manifold, tuned",
    "paper": "filters of the three papers, tuned",
    "ours": "ours, no parameter",
}

SPANS = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0)  # [frames]
RADII = (2, 3, 4, 6, 8, 11, 16, 23, 32, 45)  # [frames]
CUTOFFS = tuple(0.4 * 2.0 ** (-0.5 * step) for step in range(12))  # [cycles per frame]
LIKENESS = tuple(0.004 * 2.0 ** (0.5 * step) for step in range(19))  # [rad]
RATIOS = tuple(2.0 ** (4 - step) for step in range(12))  # process over measurement noise


@dataclass(frozen=True)
class Method:
    """One row of the table.

    Attributes:
        kind: One of :data:`KINDS`.
        settings: What the oracle chooses from: functions of ``(..., T, J, 4)``, by name.
        missing: The name in the package of what is absent from it.
    """

    kind: str
    settings: dict[str, Denoise] = field(default_factory=dict)
    missing: str = ""


def methods() -> dict[str, Method]:
    """All rows. One line adds one."""
    return {
        NOISY: Method("input", {"": nn.Identity()}),
        "components, renormalised": wrong(components, sigma_t=SPANS),
        "nine matrix entries": wrong(nine_entries, radius=RADII),
        "rotation vectors (VIBE)": wrong(
            rotation_vectors, min_cutoff=CUTOFFS[2::2], beta=(0.02, 0.1, 0.7)
        ),
        "increments integrated": wrong(integrated_increments, sigma_t=SPANS[::2]),
        "logarithms at identity": wrong(logs_at_identity, sigma_t=SPANS),
        "Gaussian": usual(GaussianFilter, sigma_t=SPANS),
        "moving mean (Blender)": Method(
            "usual", _passes(MovingMeanFilter(), (1, 2, 4, 8, 16, 32, 64))
        ),
        "Savitzky-Golay": usual(SavitzkyGolayFilter, radius=RADII, order=(2, 4)),
        "Butterworth": usual(ButterworthFilter, cutoff=CUTOFFS, order=(2,)),
        "One-Euro": usual(OneEuroFilter, min_cutoff=CUTOFFS[::2], beta=(0.02, 0.1, 0.4, 1.5)),
        "Kalman/RTS": usual(
            KalmanSmoother, process_noise=RATIOS, measurement_noise=(1.0,), order=(2,)
        ),
        "median": usual(MedianFilter, radius=(1, 2, 3, 4, 6, 9, 13, 19, 27)),
        "Hampel": usual(HampelFilter, radius=(2, 3, 5), n_sigmas=(3.0, 5.0, 8.0)),
        "principal components": usual(
            PrincipalComponentFilter, components=(2, 4, 6, 9, 13, 18, 26, 36)
        ),
        "kernel PCA": usual(KernelPCAFilter, components=(4, 8, 16, 32)),
        "bilateral": paper(BilateralFilter, sigma_t=SPANS[3:11], sigma_g=LIKENESS[3::3]),
        "non-local, poses": paper(NonLocalPoseMeans, sigma=LIKENESS, groups=("pose",)),
        "non-local, joints": paper(NonLocalPoseMeans, sigma=LIKENESS, groups=("joint",)),
        "lifting, Haar": paper(
            LiftingDenoiser, wavelet=("haar",), rule=("universal", "sure", "bayes"), **SPINS
        ),
        "lifting, linear": paper(
            LiftingDenoiser, wavelet=("linear",), rule=("universal", "sure", "bayes"), **SPINS
        ),
        "low-rank trajectories": ours("LowRankFilter"),
        "local spectra": ours("LocalSpectrumFilter"),
        "AutoDenoiser": ours("AutoDenoiser"),
    }


SPINS = {"levels": (3, 5, 7), "cycle_spins": (8,)}


def usual(make: Callable[..., Denoise], **choices: tuple) -> Method:
    """A filter that is in use today, with all combinations of settings."""
    return Method("usual", _grid(make, choices))


def paper(make: Callable[..., Denoise], **choices: tuple) -> Method:
    """A filter of one of the papers, with all combinations of settings."""
    return Method("paper", _grid(make, choices))


def wrong(function: Callable[..., np.ndarray], **choices: tuple) -> Method:
    """A wrong way, with all combinations of settings."""
    return Method("wrong", _grid(lambda **setting: _OnArrays(function, setting), choices))


def ours(name: str) -> Method:
    """A filter of this package that takes no parameter, if the package has it."""
    make = getattr(torchquat, name, None)
    return Method("ours", missing=name) if make is None else Method("ours", {"": make()})


class _OnArrays:
    """A function of arrays ``(T, J, 4)``, made one of tensors ``(..., T, J, 4)``."""

    def __init__(self, function: Callable[..., np.ndarray], setting: dict[str, object]) -> None:
        self.function = function
        self.setting = setting

    def __call__(self, q: Tensor) -> Tensor:
        """Batch items as further joints: each joint is filtered by itself."""
        lined_up = q.reshape(-1, *q.shape[-3:]).movedim(0, 1).flatten(1, 2)
        made = torch.from_numpy(self.function(lined_up.double().numpy(), **self.setting))
        return made.unflatten(1, (-1, q.shape[-2])).movedim(1, 0).reshape(q.shape).to(q)


def _grid(make: Callable[..., Denoise], choices: dict[str, tuple]) -> dict[str, Denoise]:
    settings = [
        dict(zip(choices, values, strict=True)) for values in itertools.product(*choices.values())
    ]
    varied = [name for name, values in choices.items() if len(values) > 1]
    return {
        ", ".join(f"{name} {_shown(setting[name])}" for name in varied): make(**setting)
        for setting in settings
    }


def _shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _passes(module: nn.Module, times: tuple[int, ...]) -> dict[str, Denoise]:
    """The same filter several times over."""
    return {f"passes {n}": nn.Sequential(*[module] * n) for n in times}
