"""Denoise sequences of rotations: batched, differentiable PyTorch filters on unit quaternions."""

from torchquat import io, metrics, noise, so3
from torchquat.filters import (
    BilateralFilter,
    GaussianFilter,
    LinearFilter,
    NonLocalPoseMeans,
    bilateral_filter,
    gaussian_filter,
    linear_filter,
    nonlocal_pose_means,
)
from torchquat.missing import fill_missing, validity
from torchquat.skeleton import Skeleton

__all__ = [
    "BilateralFilter",
    "GaussianFilter",
    "LinearFilter",
    "NonLocalPoseMeans",
    "Skeleton",
    "bilateral_filter",
    "fill_missing",
    "gaussian_filter",
    "io",
    "linear_filter",
    "metrics",
    "noise",
    "nonlocal_pose_means",
    "so3",
    "validity",
]
