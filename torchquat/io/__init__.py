"""Motion files: read, filter, write; what is not a rotation comes back as it was."""

from torchquat.io.estimate import Estimate, Track
from torchquat.io.estimators import load_estimate, save_estimate
from torchquat.io.files import load, save
from torchquat.io.motion import FormatError, Motion

__all__ = [
    "Estimate",
    "FormatError",
    "Motion",
    "Track",
    "load",
    "load_estimate",
    "save",
    "save_estimate",
]
