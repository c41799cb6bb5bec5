"""Motion files: read, filter, write; what is not a rotation comes back as it was."""

from torchquat.io.files import load, save
from torchquat.io.motion import FormatError, Motion

__all__ = ["FormatError", "Motion", "load", "save"]
