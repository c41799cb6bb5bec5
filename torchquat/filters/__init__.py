"""Filters on sequences of rotations, one file a family, function and module together."""

from torchquat.filters.bilateral import BilateralFilter, bilateral_filter
from torchquat.filters.linear import (
    GaussianFilter,
    LinearFilter,
    gaussian_filter,
    linear_filter,
)
from torchquat.filters.nonlocal_means import NonLocalPoseMeans, nonlocal_pose_means

__all__ = [
    "BilateralFilter",
    "GaussianFilter",
    "LinearFilter",
    "NonLocalPoseMeans",
    "bilateral_filter",
    "gaussian_filter",
    "linear_filter",
    "nonlocal_pose_means",
]
