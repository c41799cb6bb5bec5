"""Arguments of all filters: some that are no defaults, the defaults, and what is out of range."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from torch import nn

import torchquat as tq


class Pair(NamedTuple):
    """A module and its function, with arguments that are no defaults, and the defaults."""

    module: type[nn.Module]
    function: Callable[..., Any]
    given: dict[str, Any]
    defaults: dict[str, Any]


WINDOW = {"boundary": "reflect"}
PAIRS = {
    "gaussian": Pair(
        tq.GaussianFilter,
        tq.gaussian_filter,
        {"sigma_t": 0.7, "radius": 4, "boundary": "circular", "causal": True},
        {"sigma_t": 1.0, "radius": 3, "causal": False, "learnable": False} | WINDOW,
    ),
    "linear": Pair(
        tq.LinearFilter,
        tq.linear_filter,
        {"mask": [0.2, 0.5, 0.4], "boundary": "circular"},
        {"mask": [0.2, 0.5, 0.4]} | WINDOW,
    ),
    "bilateral": Pair(
        tq.BilateralFilter,
        tq.bilateral_filter,
        {"sigma_t": 0.7, "sigma_g": 0.3, "radius": 4, "kernel": "exponential", "iterations": 2}
        | {"boundary": "circular", "causal": False},
        {"sigma_t": 1.0, "sigma_g": 0.1, "radius": 3, "kernel": "gaussian", "iterations": 1}
        | {"causal": False, "learnable": False}
        | WINDOW,
    ),
    "nonlocal": Pair(
        tq.NonLocalPoseMeans,
        tq.nonlocal_pose_means,
        {"sigma": 0.3, "patch_radius": 1, "search_radius": 3, "groups": "joint", "chart": "global"}
        | {"boundary": "circular", "causal": False},
        {"sigma": 0.008, "patch_radius": 5, "search_radius": 10, "groups": "pose"}
        | {"chart": "local", "boundary": "replicate", "causal": False, "embedding": None},
    ),
    "lifting": Pair(
        tq.LiftingDenoiser,
        tq.lifting_denoiser,
        {"wavelet": "haar", "levels": 2, "rule": 0.2, "shrinkage": "hard", "cycle_spins": 3},
        {"wavelet": "linear", "levels": None, "rule": "universal", "shrinkage": "soft"}
        | {"cycle_spins": 1, "learnable": False},
    ),
    "savitzky-golay": Pair(
        tq.SavitzkyGolayFilter,
        tq.savitzky_golay_filter,
        {"radius": 3, "order": 2, "boundary": "circular"},
        {"radius": 3, "order": 2, "boundary": "interp"},
    ),
    "butterworth": Pair(
        tq.ButterworthFilter,
        tq.butterworth_filter,
        {"cutoff": 6.0, "order": 3, "frame_rate": 30.0, "boundary": "circular"},
        {"cutoff": 0.2, "order": 2, "frame_rate": 1.0} | WINDOW,
    ),
    "median": Pair(
        tq.MedianFilter,
        tq.median_filter,
        {"radius": 2, "iterations": 2, "boundary": "circular"},
        {"radius": 2, "iterations": 10} | WINDOW,
    ),
    "hampel": Pair(
        tq.HampelFilter,
        tq.hampel_filter,
        {"radius": 2, "n_sigmas": 0.5, "iterations": 2, "boundary": "circular"},
        {"radius": 2, "n_sigmas": 3.0, "iterations": 10} | WINDOW,
    ),
    "one-euro": Pair(
        tq.OneEuroFilter,
        tq.one_euro_filter,
        {"min_cutoff": 1.0, "beta": 0.2, "d_cutoff": 3.0, "frame_rate": 30.0},
        {"min_cutoff": 0.1, "beta": 0.2, "d_cutoff": 1.0, "frame_rate": 1.0},
    ),
    "kalman": Pair(
        tq.KalmanSmoother,
        tq.kalman_smoother,
        {"process_noise": 0.1, "measurement_noise": 0.4, "order": 3},
        {"process_noise": 0.1, "measurement_noise": 0.4, "order": 2, "learnable": False},
    ),
    "principal-components": Pair(
        tq.PrincipalComponentFilter,
        tq.principal_component_filter,
        {"components": 2},
        {"components": 2},
    ),
    "kernel-pca": Pair(
        tq.KernelPCAFilter,
        tq.kernel_pca_filter,
        {"components": 2, "sigma": 0.4, "landmarks": 8, "iterations": 3},
        {"components": 2, "sigma": None, "landmarks": 256, "iterations": 10},
    ),
    "local-spectrum": Pair(
        tq.LocalSpectrumFilter,
        tq.local_spectrum_filter,
        {"window": 8, "sigma": 0.1},
        {"window": 64, "sigma": None},
    ),
    "low-rank": Pair(
        tq.LowRankFilter,
        tq.low_rank_filter,
        {"window": 4, "sigma": 0.1},
        {"window": 8, "sigma": None},
    ),
    "auto": Pair(tq.AutoDenoiser, tq.denoise, {"strength": 0.5}, {"strength": 1.0}),
    "moving-mean": Pair(tq.MovingMeanFilter, tq.moving_mean_filter, {}, {}),
    "repair": Pair(tq.OutlierRepair, lambda q, weight: tq.repair(q, weight)[0], {}, {}),
}
NEEDED = {
    "linear": ("mask",),
    "savitzky-golay": ("radius", "order"),
    "butterworth": ("cutoff",),
    "median": ("radius",),
    "hampel": ("radius",),
    "one-euro": ("min_cutoff", "beta"),
    "kalman": ("process_noise", "measurement_noise"),
    "principal-components": ("components",),
    "kernel-pca": ("components",),
}
"""Arguments without a default."""
POSITIVE = (0.0, -1.0, math.nan, math.inf)
COUNT = (-1, 1.5, "3")
RANGES = {
    "gaussian": {"sigma_t": POSITIVE, "radius": COUNT, "boundary": ("mirror",)},
    "linear": {"mask": ([0.0], [-1.0], [math.nan], [math.inf])},
    "bilateral": {
        "sigma_t": POSITIVE,
        "sigma_g": POSITIVE,
        "radius": COUNT,
        "iterations": COUNT,
        "kernel": ("box",),
        "boundary": ("mirror",),
    },
    "nonlocal": {
        "sigma": POSITIVE,
        "patch_radius": COUNT,
        "search_radius": COUNT,
        "chart": ("flat",),
        "boundary": ("mirror",),
    },
    "lifting": {
        "levels": COUNT,
        "shrinkage": ("firm",),
        "rule": (-1.0, math.inf, "visu"),
        "cycle_spins": (0, 1.5),
    },
    "savitzky-golay": {"radius": COUNT, "order": COUNT, "boundary": ("mirror",)},
    "butterworth": {
        "cutoff": POSITIVE,
        "order": (0, 1.5),
        "frame_rate": POSITIVE,
        "boundary": ("mirror",),
    },
    "median": {"radius": COUNT, "iterations": COUNT, "boundary": ("mirror",)},
    "hampel": {"radius": COUNT, "n_sigmas": (-1.0, math.nan), "iterations": COUNT},
    "one-euro": {
        "min_cutoff": POSITIVE,
        "beta": (-1.0, math.nan),
        "d_cutoff": POSITIVE,
        "frame_rate": POSITIVE,
    },
    "kalman": {"process_noise": POSITIVE, "measurement_noise": POSITIVE, "order": (0, 4)},
    "principal-components": {"components": (0, -1, 1.5, math.nan)},
    "kernel-pca": {
        "components": (0, 1.5),
        "sigma": POSITIVE,
        "landmarks": (0, 1.5),
        "iterations": COUNT,
    },
    "local-spectrum": {"window": (1, 1.5), "sigma": POSITIVE},
    "low-rank": {"window": (0, 1.5), "sigma": POSITIVE},
    "auto": {"strength": (-1.0, math.nan, math.inf)},
}
