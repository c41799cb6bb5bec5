"""Functions of squares whose singularity at 0 is removable.

Each has two forms. Where derivatives may be asked for, a series stands in near 0, so that first and
second derivatives are finite. Where not, the argument is kept away from 0 by a number too small to
be seen in the result.
"""

import torch
from torch import Tensor

from torchquat._eager import derivatives

__all__ = [
    "angle_over_half_sine",
    "horner",
    "invisible",
    "sinc_and_cosine",
    "squared_angle_and_factor",
    "squared_arcsine",
]


def squared_arcsine(square: Tensor) -> Tensor:
    """``asin(s)^2`` of ``s^2`` in [0, 1/2]."""
    if not derivatives(square):
        return square.sqrt().asin_().square_()
    # the series ends in s^12 / 20, below one rounding error under this bound
    small = square < (torch.finfo(square.dtype).eps * 20) ** (1 / 6)
    near = torch.where(small, square, 0.0)
    series = near * horner(near, 1, 1 / 3, 8 / 45, 4 / 35, 128 / 1575, 128 / 2079)
    return torch.where(small, series, torch.where(small, 0.25, square).sqrt().asin().square())


def angle_over_half_sine(square: Tensor) -> Tensor:
    """``t / sin(t / 2)`` of ``sin(t / 4)^2`` in [0, 1/2]; ``t`` is a rotation angle.

    By the sine of a quarter of the angle: no pole at half turns and, unlike ``atan2``, the same
    bits wherever in a tensor a number stands.
    """
    if not derivatives(square):
        square = square + invisible(square)
        quarter = square.sqrt().asin_()
        return torch.addcmul(square, square, square, value=-1.0).rsqrt_().mul_(quarter).mul_(2.0)
    # the series ends in s^12 / 3, below one rounding error under this bound
    small = square < (torch.finfo(square.dtype).eps * 3) ** (1 / 6)
    near = torch.where(small, square, 0.0)
    series = 2.0 * horner(near, 1, 2 / 3, 8 / 15, 16 / 35, 128 / 315, 256 / 693)
    far = torch.where(small, 0.25, square)
    return torch.where(small, series, 2.0 * far.sqrt().asin() * (far * (1.0 - far)).rsqrt())


def squared_angle_and_factor(square: Tensor) -> tuple[Tensor, Tensor]:
    """``t^2`` and :func:`angle_over_half_sine` of ``sin(t / 4)^2`` in [0, 1/2]."""
    if derivatives(square):
        return 16.0 * squared_arcsine(square), angle_over_half_sine(square)
    square = square + invisible(square)
    quarter = square.sqrt().asin_()
    factor = torch.addcmul(square, square, square, value=-1.0).rsqrt_().mul_(quarter).mul_(2.0)
    return quarter.mul_(4.0).square_(), factor


def sinc_and_cosine(square: Tensor) -> tuple[Tensor, Tensor]:
    """``sin(h) / h`` and ``cos(h)`` of ``h^2``."""
    if not derivatives(square):
        angle = (square + invisible(square)).sqrt_()
        return angle.sin().div_(angle), angle.cos_()
    # both series end in h^10 / 10!, below one rounding error under this bound
    small = square < (torch.finfo(square.dtype).eps * 3628800) ** 0.2
    series = torch.where(small, square, 0.0)
    angle = torch.where(small, 1.0, square).sqrt()
    sinc = horner(series, 1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880)
    cosine = horner(series, 1, -1 / 2, 1 / 24, -1 / 720, 1 / 40320)
    return torch.where(small, sinc, angle.sin() / angle), torch.where(small, cosine, angle.cos())


def invisible(like: Tensor) -> float:
    """Keeps a root away from 0: too small to be seen in the square of anything that counts."""
    return torch.finfo(like.dtype).tiny / torch.finfo(like.dtype).eps


def horner(x: Tensor, *coefficients: float) -> Tensor:
    """Polynomial with the constant term first."""
    *rest, last = coefficients
    value = last * x + rest[-1]
    for coefficient in reversed(rest[:-1]):
        value = value * x + coefficient
    return value
