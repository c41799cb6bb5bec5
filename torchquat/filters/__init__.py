"""Filters on sequences of rotations, one file a family, function and module together."""

from torchquat.filters.auto import AutoDenoiser, denoise
from torchquat.filters.bilateral import (
    BilateralFilter,
    bilateral_filter,
)
from torchquat.filters.editing import compress, salience, scale_details, stored_share
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
from torchquat.filters.nonlocal_means import (
    NonLocalPoseMeans,
    nonlocal_pose_means,
)
from torchquat.filters.shrinkage import (
    LiftingDenoiser,
    lifting_denoiser,
)
from torchquat.filters.spectral import LocalSpectrumFilter, local_spectrum_filter

__all__ = [
    "AutoDenoiser",
    "BezierPredict",
    "BilateralFilter",
    "GaussianFilter",
    "HaarPredict",
    "HaarUpdate",
    "LiftingDenoiser",
    "LiftingStep",
    "LiftingTransform",
    "LinearFilter",
    "LinearPredict",
    "LinearUpdate",
    "LocalSpectrumFilter",
    "NonLocalPoseMeans",
    "Pyramid",
    "SquadPredict",
    "bilateral_filter",
    "compress",
    "denoise",
    "gaussian_filter",
    "lifting_denoiser",
    "linear_filter",
    "local_spectrum_filter",
    "nonlocal_pose_means",
    "salience",
    "scale_details",
    "stored_share",
]
