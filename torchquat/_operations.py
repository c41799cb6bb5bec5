"""The operations that filters are made of, with backward passes written by hand.

On planes, as in :mod:`torchquat._planes`. PyTorch would keep some thirty planes for the logarithm
of one quaternion and walk back through each; here the inputs are kept and the rest is computed
again, in fewer and cheaper steps.
"""

import math

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import derivatives, highest, lowest, recorded
from torchquat._planes import Quaternion, Vector
from torchquat._pull_back import Planes, run
from torchquat._series import (
    angle_over_half_sine,
    horner,
    invisible,
    sinc_and_cosine,
    squared_angle_and_factor,
    squared_arcsine,
)

__all__ = [
    "accumulated",
    "apart",
    "between",
    "between_back",
    "nearest",
    "normalized",
    "split",
    "squared_angle",
    "turned",
    "turned_both_ways",
]


def split(q: Tensor) -> Quaternion:
    """Components of quaternions ``(..., 4)``, one after the other in memory."""
    x, y, z, w = run(_planes.split, _split_back, q)
    return x, y, z, w


def between(a: Quaternion, b: Quaternion) -> Vector:
    """Rotation vector from ``a`` to ``b`` [rad], where their scalar product is >= 0.

    The difference of neighbours is exact, so small angles keep their relative precision, where
    ``a^-1 b`` itself would lose 1e-3 of 1e-4 rad in float32.
    """
    x, y, z = run(_between, between_back, *torch.broadcast_tensors(*a, *b))
    return x, y, z


def turned(q: Quaternion, v: Vector) -> Quaternion:
    """``q exp(v)``, turned by a rotation vector [rad]; it stays in the hemisphere of ``q``."""
    x, y, z, w = run(_turned, _turned_back, *torch.broadcast_tensors(*q, *v))
    return x, y, z, w


def turned_both_ways(q: Quaternion, v: Vector) -> tuple[Quaternion, Quaternion]:
    """``q exp(v)`` and ``q exp(-v)``, both in the hemisphere of ``q``."""
    planes = run(_both_ways, _both_ways_back, *torch.broadcast_tensors(*q, *v))
    (x, y, z, w), (a, b, c, d) = planes[:4], planes[4:]
    return (x, y, z, w), (a, b, c, d)


def squared_angle(a: Quaternion, b: Quaternion) -> Tensor:
    """Squared rotation angle [rad^2] between unit quaternions of any signs."""
    return run(_squared_angle, _squared_angle_back, *torch.broadcast_tensors(*a, *b))[0]


def normalized(q: Quaternion) -> Quaternion:
    """Unit quaternions in the direction of ``q``, of ordinary length."""
    x, y, z, w = run(_normalized, _normalized_back, *q)
    return x, y, z, w


def apart(a: Quaternion, b: Quaternion) -> tuple[Tensor, Tensor]:
    """How far unit quaternions of any signs lie apart.

    Returns:
        The squared rotation angle [rad^2], and by what the vector part of ``a^-1 b`` must be
        multiplied to give the rotation vector from ``a`` to ``b``.
    """
    square, factor = run(_apart, _apart_back, *torch.broadcast_tensors(*a, *b), keep=True)
    return square, factor


def accumulated(total: Planes, m: float | Tensor, v: Planes, sign: int = 1) -> Planes:
    """``total + sign m v``; in place where no derivative is asked for."""
    if isinstance(m, Tensor) and recorded(m, *v):
        parts = run(_scaled, _scaled_back, m if sign > 0 else -m, *v)
        return tuple(t + part for t, part in zip(total, parts, strict=True))
    kept = derivatives(*total, *v) or (isinstance(m, Tensor) and derivatives(m))
    return tuple(
        torch.addcmul(t, m, c, value=sign, out=None if kept else t)
        if isinstance(m, Tensor)
        else torch.add(t, c, alpha=sign * m, out=None if kept else t)
        for t, c in zip(total, v, strict=True)
    )


def _split_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    return (_planes.join(slope),)


def _between(*planes: Tensor) -> Planes:
    a, b = planes[:4], planes[4:]
    difference = _subtracted(b, a)
    factor = angle_over_half_sine(0.25 * _planes.dot(difference, difference))
    return tuple(factor * component for component in _planes.vector_part(a, difference))


def between_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    a, b = planes[:4], planes[4:]
    difference = _subtracted(b, a)
    x = 0.25 * _planes.dot(difference, difference)
    factor = angle_over_half_sine(x)
    along = _planes.dot(slope, _planes.vector_part(a, difference))
    rate = _factor_slope(x, factor).mul_(along)
    inner = [factor * s for s in slope]
    ahead = [
        torch.addcmul(turn, rate, d)
        for turn, d in zip(_planes.by_vector(a, inner), difference, strict=True)
    ]
    behind = [
        torch.addcmul(turn, rate, d).neg_()
        for turn, d in zip(_planes.by_vector(b, inner), difference, strict=True)
    ]
    return *behind, *ahead


def _turned(*planes: Tensor) -> Planes:
    qx, qy, qz, qw, *v = planes
    x, y, z, w = _planes.upper(_planes.exp((v[0], v[1], v[2])))
    return _planes.compose((qx, qy, qz, qw), (x, y, z, w))


def _turned_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    (qx, qy, qz, qw), v = planes[:4], planes[4:]
    gx, gy, gz, gw = slope
    square = 0.25 * _planes.dot(v, v) + invisible(qx)
    sinc, cosine = sinc_and_cosine(square)
    bent = (cosine - sinc).div_(square).mul_(0.125)
    if not lowest(cosine) >= 0:  # the other sign was taken
        sign = _planes.sign_of(cosine)
        sinc, cosine, bent = sign * sinc, sign * cosine, sign * bent
    half = 0.5 * sinc
    x, y, z = (half * component for component in v)
    back = _planes.compose((gx, gy, gz, gw), (-x, -y, -z, cosine))
    tx, ty, tz, tw = _planes.compose((-qx, -qy, -qz, qw), (gx, gy, gz, gw))
    along = bent.mul_(_planes.dot((tx, ty, tz), v)).addcmul_(half, tw, value=-0.5)
    turn = (torch.addcmul(half * t, along, c) for t, c in zip((tx, ty, tz), v, strict=True))
    return *back, *turn


def _both_ways(*planes: Tensor) -> Planes:
    q, v = planes[:4], planes[4:]
    x, y, z, w = _planes.upper(_planes.exp((v[0], v[1], v[2])))
    turn = _planes.by_vector(q, [x, y, z])
    along = [w * c for c in q]
    ahead = (a + t for a, t in zip(along, turn, strict=True))
    return *ahead, *(a - t for a, t in zip(along, turn, strict=True))


def _both_ways_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    q, v = planes[:4], planes[4:]
    *ahead_q, x, y, z = _turned_back(planes, result[:4], slope[:4])
    *back_q, a, b, c = _turned_back((*q, *(-c for c in v)), result[4:], slope[4:])
    both = (g + h for g, h in zip(ahead_q, back_q, strict=True))
    return *both, x - a, y - b, z - c


def _squared_angle(*planes: Tensor) -> Planes:
    _, _, square = nearest(planes)
    return (16.0 * squared_arcsine(0.25 * square),)


def _squared_angle_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    sign, difference, square = nearest(planes)
    rate = angle_over_half_sine(0.25 * square).mul_(slope[0]).mul_(4.0)
    return _opposed(rate, difference, sign)


def _apart(*planes: Tensor) -> Planes:
    sign, _, square = nearest(planes)
    angle, factor = squared_angle_and_factor(0.25 * square)
    return angle, factor if sign is None else sign * factor


def _apart_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    sign, difference, square = nearest(planes)
    _, factor = result
    by_angle, by_factor = slope
    if sign is not None:
        factor, by_factor = sign * factor, sign * by_factor
    rate = _factor_slope(0.25 * square, factor).mul_(by_factor)
    return _opposed(rate.addcmul_(factor, by_angle, value=4.0), difference, sign)


def nearest(planes: Planes) -> tuple[Tensor | None, Planes, Tensor]:
    """Sign of the nearer one of ``b`` and ``-b``, how it differs from ``a``, and the square of it.

    The square is ``4 sin^2(angle / 4)``; the sign is ``None`` where all are seen to be near.
    """
    a, b = planes[:4], planes[4:]
    difference = _subtracted(b, a)
    square = _planes.dot(difference, difference)
    if highest(square) <= 2.0:
        return None, difference, square
    sign = _planes.sign_of(2.0 - square)
    difference = _subtracted(tuple(sign * plane for plane in b), a)
    return sign, difference, _planes.dot(difference, difference)


def _opposed(rate: Tensor, difference: Planes, sign: Tensor | None) -> Planes:
    """Gradients that pull ``b`` one way and ``a`` the other."""
    ahead = tuple(rate * d for d in difference)
    return *(-d for d in ahead), *(ahead if sign is None else (sign * d for d in ahead))


def _factor_slope(x: Tensor, factor: Tensor) -> Tensor:
    """Half the derivative of :func:`angle_over_half_sine`, given its value."""
    bound = (torch.finfo(x.dtype).eps / 4.0) ** (1 / 8)  # the series ends in 2.5 x^8
    if highest(x) < bound:
        return horner(x, *_FACTOR_SLOPE)
    slope = torch.addcmul(factor, x, factor, value=-2.0).neg_().add_(2.0)
    slope = slope.div_(torch.addcmul(x, x, x, value=-1.0).mul_(4.0))
    return torch.where(x < bound, horner(x, *_FACTOR_SLOPE), slope)


# k a_k, with the coefficients a_k = a_{k-1} 2k / (2k + 1) of half the function
_FACTOR_SLOPE = tuple(
    k * math.prod(2 * n / (2 * n + 1) for n in range(1, k + 1)) for k in range(1, 9)
)


def _scaled(m: Tensor, *v: Tensor) -> Planes:
    return tuple(m * component for component in v)


def _scaled_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    m, *v = planes
    return _planes.dot(slope, v).sum_to_size(m.shape), *(m * g for g in slope)


def _normalized(*planes: Tensor) -> Planes:
    inverse = _planes.dot(planes, planes).rsqrt()
    return tuple(inverse * plane for plane in planes)


def _normalized_back(planes: Planes, result: Planes, slope: Planes) -> Planes:
    inverse = _planes.dot(planes, planes).rsqrt()
    along = inverse.square().mul_(_planes.dot(planes, slope))
    return tuple(
        torch.addcmul(g, along, plane, value=-1.0).mul_(inverse)
        for plane, g in zip(planes, slope, strict=True)
    )


def _subtracted(b: Planes, a: Planes) -> Planes:
    return tuple(second - first for first, second in zip(a, b, strict=True))
