"""Filters on sequences of rotations, one file a family, function and module together."""

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
from torchquat.filters.repair import OutlierRepair, repair
from torchquat.filters.shrinkage import (
    LiftingDenoiser,
    lifting_denoiser,
)

__all__ = [
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
    "NonLocalPoseMeans",
    "OutlierRepair",
    "Pyramid",
    "SquadPredict",
    "bilateral_filter",
    "compress",
    "gaussian_filter",
    "lifting_denoiser",
    "linear_filter",
    "nonlocal_pose_means",
    "repair",
    "salience",
    "scale_details",
    "stored_share",
]
