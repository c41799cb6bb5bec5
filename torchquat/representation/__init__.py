"""Rotations as others write them: vectors, matrices, their columns, Euler angles."""

from torchquat.representation.adapter import RepresentationAdapter
from torchquat.representation.branch import continuous_rotvec
from torchquat.representation.conversion import convert

__all__ = ["RepresentationAdapter", "continuous_rotvec", "convert"]
