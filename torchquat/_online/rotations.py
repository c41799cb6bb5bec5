"""Rotations in as few calls as possible, for one frame or one window; no derivatives.

Quaternions and vectors are one tensor each, components first: ``(4, ...)`` and ``(3, ...)``.
"""

import math
from functools import lru_cache

import torch
from torch import Tensor

__all__ = [
    "angle_and_factor",
    "between",
    "exp",
    "nearer",
    "quarter_angle",
    "squared_norm",
    "tangent_part",
    "turn",
    "turn_along",
]

Table = tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]
"""Which component of the first factor meets which of the second, and with which sign."""

QUOTIENT: Table = (
    ((3, 2, 1, 0), (-1, -1, 1, 1)),
    ((2, 3, 0, 1), (1, -1, -1, 1)),
    ((1, 0, 3, 2), (-1, 1, -1, 1)),
)
BY_VECTOR: Table = (
    ((3, 2, 1), (1, -1, 1)),
    ((2, 3, 0), (1, 1, -1)),
    ((1, 0, 3), (-1, 1, 1)),
    ((0, 1, 2), (-1, -1, -1)),
)


def squared_norm(x: Tensor) -> Tensor:
    """Sum of the squared components of ``(C, ...)``."""
    return (x * x).sum(0)


def nearer(q: Tensor, reference: Tensor) -> Tensor:
    """Of ``q`` and ``-q`` the one in the hemisphere of ``reference``, ``(4, ...)``."""
    cosine = (q * reference).sum(0)
    return torch.copysign(_one(q.dtype, q.device), cosine) * q


def angle_and_factor(square: Tensor) -> tuple[Tensor, Tensor]:
    """What a squared difference of quaternions in one hemisphere, at most 2, says of them.

    Returns:
        A quarter of the angle between them [rad], never 0, and by what the vector part of their
        quotient must be multiplied to give the rotation vector. As in :mod:`torchquat._series`.
    """
    sine = (0.25 * square).add_(1e-30)  # of a quarter of the angle, squared
    quarter = sine.sqrt().asin_()
    return quarter, torch.addcmul(sine, sine, sine, value=-1.0).rsqrt_().mul_(quarter).mul_(2.0)


def quarter_angle(square: Tensor) -> Tensor:
    """A quarter of the rotation angle [rad] of a squared difference of quaternions of any signs."""
    near = torch.minimum(square, 4.0 - square)
    return near.mul_(0.25).clamp_(min=0.0).sqrt_().asin_()


def between(a: Tensor, b: Tensor) -> Tensor:
    """Rotation vectors ``(3, ...)`` [rad] from ``a`` to ``b``, which lie in one hemisphere."""
    # the difference of neighbours is exact: small angles keep their relative precision
    difference = b - a
    _, factor = angle_and_factor(squared_norm(difference))
    return factor * _bilinear(QUOTIENT, difference, a)


def exp(v: Tensor) -> Tensor:
    """Unit quaternions of rotation vectors ``(3, ...)`` [rad]."""
    angle = squared_norm(v).sqrt_()
    half_sinc = torch.sinc(angle * (0.5 / math.pi)).mul_(0.5)
    return torch.cat([half_sinc * v, torch.cos(0.5 * angle)[None]])


def tangent_part(q: Tensor, ambient: Tensor) -> Tensor:
    """What of vectors ``(4, ...)`` is orthogonal to ``q``."""
    return torch.addcmul(ambient, (q * ambient).sum(0), q, value=-1.0)


def turn(q: Tensor, v: Tensor) -> Tensor:
    """``q exp(v)`` for rotation vectors ``(3, ...)`` [rad]."""
    return turn_along(q, _bilinear(BY_VECTOR, q, v), squared_norm(v).sqrt_())


def turn_along(q: Tensor, tangent: Tensor, angle: Tensor) -> Tensor:
    """Turn ``q`` by an angle [rad] along a tangent ``(4, ...)`` of that length on the 3-sphere."""
    half_sinc = torch.sinc(angle * (0.5 / math.pi)).mul_(0.5)
    return torch.addcmul(torch.cos(0.5 * angle) * q, half_sinc, tangent)


def _bilinear(table: Table, a: Tensor, b: Tensor) -> Tensor:
    """Sums of products of components of ``a`` and ``b``; each row of the table makes one."""
    index, sign = _constants(table, b.dim(), b.dtype, b.device)
    chosen = a.index_select(0, index).view(*sign.shape[:2], *a.shape[1:])
    return (chosen * (sign * b)).sum(1)


@lru_cache(maxsize=64)
def _one(dtype: torch.dtype, device: torch.device) -> Tensor:
    with torch.inference_mode(False):
        return torch.ones((), dtype=dtype, device=device)


@lru_cache(maxsize=64)
def _constants(
    table: Table, dim: int, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor]:
    with torch.inference_mode(False):
        index = torch.tensor([place for row, _ in table for place in row], device=device)
        sign = torch.tensor([signs for _, signs in table], dtype=dtype, device=device)
        return index, sign.reshape(*sign.shape, *[1] * (dim - 1))
