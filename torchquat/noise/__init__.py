"""Corruption of clean rotations, and how much noise there is in those that are not.

Every draw takes a ``generator``. Frames without a direction, those that are missing, come back as
they were, so that corruptions can follow one another in any order.
"""

from torchquat.noise.estimate import estimate_sigma
from torchquat.noise.lasting import correlated, dropout, pops
from torchquat.noise.single import flip_signs, gaussian, impulse, quantise

__all__ = [
    "correlated",
    "dropout",
    "estimate_sigma",
    "flip_signs",
    "gaussian",
    "impulse",
    "pops",
    "quantise",
]
