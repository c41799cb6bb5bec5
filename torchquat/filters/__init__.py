"""Filters on sequences of rotations, one file a family, function and module together."""

from torchquat.filters.auto import AutoDenoiser, denoise
from torchquat.filters.bilateral import (
    BilateralFilter,
    bilateral_filter,
)
from torchquat.filters.butterworth import ButterworthFilter, butterworth_filter
from torchquat.filters.editing import compress, salience, scale_details, stored_share
from torchquat.filters.learned import LearnedPredict, LearnedUpdate, PatchEmbedding
from torchquat.filters.lifting import (
    BezierPredict,
    HaarPredict,
    HaarUpdate,
    LiftingStep,
    LiftingTransform,
    LinearPredict,
    LinearUpdate,
    Pyramid,
    SquadPredict,
)
from torchquat.filters.linear import (
    GaussianFilter,
    LinearFilter,
    gaussian_filter,
    linear_filter,
)
from torchquat.filters.low_rank import LowRankFilter, low_rank_filter
from torchquat.filters.moving_mean import MovingMeanFilter, moving_mean_filter
from torchquat.filters.nonlocal_means import (
    NonLocalPoseMeans,
    nonlocal_pose_means,
)
from torchquat.filters.one_euro import OneEuroFilter, one_euro_filter
from torchquat.filters.repair import OutlierRepair, repair
from torchquat.filters.robust import HampelFilter, MedianFilter, hampel_filter, median_filter
from torchquat.filters.savitzky_golay import SavitzkyGolayFilter, savitzky_golay_filter
from torchquat.filters.shrinkage import (
    LiftingDenoiser,
    lifting_denoiser,
)
from torchquat.filters.spectral import LocalSpectrumFilter, local_spectrum_filter
from torchquat.filters.subspace import (
    KernelPCAFilter,
    PrincipalComponentFilter,
    kernel_pca_filter,
    principal_component_filter,
)
from torchquat.filters.tracking import KalmanSmoother, kalman_smoother

__all__ = [
    "AutoDenoiser",
    "BezierPredict",
    "BilateralFilter",
    "ButterworthFilter",
    "GaussianFilter",
    "HaarPredict",
    "HaarUpdate",
    "HampelFilter",
    "KalmanSmoother",
    "KernelPCAFilter",
    "LearnedPredict",
    "LearnedUpdate",
    "LiftingDenoiser",
    "LiftingStep",
    "LiftingTransform",
    "LinearFilter",
    "LinearPredict",
    "LinearUpdate",
    "LocalSpectrumFilter",
    "LowRankFilter",
    "MedianFilter",
    "MovingMeanFilter",
    "NonLocalPoseMeans",
    "OneEuroFilter",
    "OutlierRepair",
    "PatchEmbedding",
    "PrincipalComponentFilter",
    "Pyramid",
    "SavitzkyGolayFilter",
    "SquadPredict",
    "bilateral_filter",
    "butterworth_filter",
    "compress",
    "denoise",
    "gaussian_filter",
    "hampel_filter",
    "kalman_smoother",
    "kernel_pca_filter",
    "lifting_denoiser",
    "linear_filter",
    "local_spectrum_filter",
    "low_rank_filter",
    "median_filter",
    "moving_mean_filter",
    "nonlocal_pose_means",
    "one_euro_filter",
    "principal_component_filter",
    "repair",
    "salience",
    "savitzky_golay_filter",
    "scale_details",
    "stored_share",
]
