"""Filters on sequences of rotations, one file a family, function and module together."""

from torchquat.filters.bilateral import BilateralFilter, bilateral_filter
from torchquat.filters.linear import (
    GaussianFilter,
    LinearFilter,
    gaussian_filter,
    linear_filter,
)

__all__ = [
    "BilateralFilter",
    "GaussianFilter",
    "LinearFilter",
    "bilateral_filter",
    "gaussian_filter",
    "linear_filter",
]
