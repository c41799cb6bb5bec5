"""Rotations component by component: the arithmetic of :mod:`torchquat.so3` and of the filters.

A quaternion is a tuple of four tensors ``(x, y, z, w)``, a vector one of three; all broadcast. On
planes that lie in memory one after the other every operation runs at the speed of the cache, which
operations along a last axis of length four do not.

Functions with a removable singularity have two forms. Where derivatives may be asked for, a series
stands in near it, so that first and second derivatives are finite. Where not, the argument is kept
away from it by a number too small to be seen in the result.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat._eager import derivatives, lowest

__all__ = [
    "Quaternion",
    "Vector",
    "align_path",
    "angle",
    "between",
    "compose",
    "cut",
    "dot",
    "exp",
    "join",
    "log",
    "relative",
    "split",
    "squared_angle",
    "upper",
]

Quaternion = tuple[Tensor, Tensor, Tensor, Tensor]
Vector = tuple[Tensor, Tensor, Tensor]


def split(q: Tensor) -> Quaternion:
    """Components of quaternions ``(..., 4)``, each contiguous."""
    x, y, z, w = torch.stack(q.unbind(-1)).unbind(0)
    return x, y, z, w


def join(parts: Sequence[Tensor]) -> Tensor:
    """Tensor ``(..., 4)`` or ``(..., 3)`` of components, broadcast against each other.

    The components still lie one after the other in memory, so that what comes next finds them so;
    not in a compiler, which would tie the program to the strides that it has seen.
    """
    joined = torch.stack(torch.broadcast_tensors(*parts)).movedim(0, -1)
    return joined.contiguous() if torch.compiler.is_compiling() else joined


def cut(q: Quaternion, start: int, frames: int) -> Quaternion:
    """Frames of planes ``(..., N, J)``."""
    x, y, z, w = (plane.narrow(-2, start, frames) for plane in q)
    return x, y, z, w


def dot(a: Sequence[Tensor], b: Sequence[Tensor]) -> Tensor:
    """Scalar product."""
    return _signed(*zip(a, b, strict=True))


def compose(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product ``a b``."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        _signed((aw, bx), (ax, bw), (ay, bz), (-1, az, by)),
        _signed((aw, by), (ay, bw), (az, bx), (-1, ax, bz)),
        _signed((aw, bz), (ax, by), (az, bw), (-1, ay, bx)),
        _signed((aw, bw), (-1, ax, bx), (-1, ay, by), (-1, az, bz)),
    )


def relative(a: Quaternion, b: Quaternion) -> Quaternion:
    """``a^-1 b``, precise for near rotations, which must lie in one hemisphere for that.

    Computed as ``1 + a^-1 (b - a)``: the difference of neighbours is exact, so small angles keep
    their relative precision, where the product itself would lose 1e-3 of 1e-4 rad in float32.
    """
    ax, ay, az, aw = a
    dx, dy, dz, dw = (second - first for first, second in zip(a, b, strict=True))
    return (
        _signed((aw, dx), (az, dy), (-1, ax, dw), (-1, ay, dz)),
        _signed((aw, dy), (ax, dz), (-1, ay, dw), (-1, az, dx)),
        _signed((aw, dz), (ay, dx), (-1, az, dw), (-1, ax, dy)),
        _signed((aw, dw), (ax, dx), (ay, dy), (az, dz)) + 1.0,
    )


def between(a: Quaternion, b: Quaternion) -> Vector:
    """Rotation vector from ``a`` to ``b`` [rad], where their scalar product is >= 0."""
    return log(relative(a, b))


def log(q: Quaternion) -> Vector:
    """Rotation vector of unit quaternions with ``w >= 0`` [rad]."""
    x, y, z, w = q
    # by the tangent of a quarter of the angle: no pole at half turns and, unlike ``atan2``, the
    # same bits wherever in a tensor a number stands
    inverse = (1.0 + w).reciprocal()
    factor = 4.0 * inverse * _arctangent_over(dot(q[:3], q[:3]) * inverse.square())
    return factor * x, factor * y, factor * z


def exp(v: Vector) -> Quaternion:
    """Unit quaternion of a rotation vector [rad] of any finite length."""
    x, y, z = v
    sinc, cosine = _sinc_and_cosine(0.25 * dot(v, v))
    half = 0.5 * sinc
    return half * x, half * y, half * z, cosine


def squared_angle(a: Quaternion, b: Quaternion) -> Tensor:
    """Squared rotation angle [rad^2] between unit quaternions of any signs."""
    difference = [second - first for first, second in zip(a, b, strict=True)]
    square = dot(difference, difference)  # 4 sin^2(d / 4), or 4 cos^2(d / 4) if the signs differ
    return 16.0 * _squared_arcsine(0.25 * torch.minimum(square, 4.0 - square).clamp(min=0.0))


def angle(a: Quaternion, b: Quaternion) -> Tensor:
    """Rotation angle [rad] between unit quaternions of any signs; its gradient is 0 at 0."""
    square = squared_angle(a, b)
    apart = square > 0
    return torch.where(apart, torch.where(apart, square, 1.0).sqrt(), 0.0)


def upper(q: Quaternion) -> Quaternion:
    """Choose the signs so that ``w >= 0``."""
    if lowest(q[3]) >= 0:
        return q
    sign = torch.where(q[3] < 0, -1.0, 1.0).to(q[3].dtype)
    x, y, z, w = (sign * plane for plane in q)
    return x, y, z, w


def align_path(q: Quaternion) -> Quaternion:
    """Choose the signs along time so that every frame lies in the hemisphere of the one before."""
    frames = q[0].shape[-2] - 1
    step = dot(cut(q, 0, frames), cut(q, 1, frames)).detach()
    if lowest(step) >= 0:
        return q
    sign = torch.where(step < 0, -1.0, 1.0).to(step.dtype).cumprod(-2)
    sign = torch.cat([torch.ones_like(q[0].narrow(-2, 0, 1)), sign], -2)
    x, y, z, w = (sign * plane for plane in q)
    return x, y, z, w


def _signed(*products: tuple[Tensor, Tensor] | tuple[int, Tensor, Tensor]) -> Tensor:
    """Sum of products; a leading -1 subtracts one."""
    first, *rest = products
    total = first[0] * first[1]
    # into the same memory where no derivative needs it: a third faster
    place = None if derivatives(total) else total
    for product in rest:
        *sign, p, r = product
        total = torch.addcmul(total, p, r, value=sign[0] if sign else 1, out=place)
    return total


def _squared_arcsine(square: Tensor) -> Tensor:
    """``asin(s)^2`` of ``s^2`` in [0, 1/2]."""
    if not derivatives(square):
        return square.sqrt().asin().square()
    # the series ends in s^12 / 20, below one rounding error under this bound
    small = square < (torch.finfo(square.dtype).eps * 20) ** (1 / 6)
    near = torch.where(small, square, 0.0)
    series = near * _horner(near, 1, 1 / 3, 8 / 45, 4 / 35, 128 / 1575, 128 / 2079)
    return torch.where(small, series, torch.where(small, 0.25, square).sqrt().asin().square())


def _arctangent_over(square: Tensor) -> Tensor:
    """``atan(t) / t`` of ``t^2``."""
    if not derivatives(square):
        tangent = (square + _invisible(square)).sqrt()
        return tangent.atan() / tangent
    # the series ends in t^12 / 13, below one rounding error under this bound
    small = square < (torch.finfo(square.dtype).eps * 13) ** (1 / 6)
    near = torch.where(small, square, 0.0)
    series = _horner(near, 1, -1 / 3, 1 / 5, -1 / 7, 1 / 9, -1 / 11)
    tangent = torch.where(small, 1.0, square).sqrt()
    return torch.where(small, series, tangent.atan() / tangent)


def _sinc_and_cosine(square: Tensor) -> tuple[Tensor, Tensor]:
    """``sin(h) / h`` and ``cos(h)`` of ``h^2``."""
    if not derivatives(square):
        angle = (square + _invisible(square)).sqrt()
        return angle.sin() / angle, angle.cos()
    # both series end in h^10 / 10!, below one rounding error under this bound
    small = square < (torch.finfo(square.dtype).eps * 3628800) ** 0.2
    series = torch.where(small, square, 0.0)
    angle = torch.where(small, 1.0, square).sqrt()
    sinc = _horner(series, 1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880)
    cosine = _horner(series, 1, -1 / 2, 1 / 24, -1 / 720, 1 / 40320)
    return torch.where(small, sinc, angle.sin() / angle), torch.where(small, cosine, angle.cos())


def _invisible(like: Tensor) -> float:
    """Keeps a root away from 0: too small to be seen in the square of anything that counts."""
    return torch.finfo(like.dtype).tiny / torch.finfo(like.dtype).eps


def _horner(x: Tensor, *coefficients: float) -> Tensor:
    """Polynomial with the constant term first."""
    value = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value
