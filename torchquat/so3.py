"""Rotations as unit quaternions, with finite first and second derivatives everywhere.

Convention of the whole package: components ``(x, y, z, w)``, Hamilton product, active rotations;
``compose(a, b)`` applies ``b`` first. A rotation vector lives in the body frame,
``q1 = compose(q0, exp(v))``, and its norm is the rotation angle [rad]. ``q`` and ``-q`` are the
same rotation: ``log``, ``distance`` and ``slerp`` always take the short arc.

All functions broadcast over the leading axes and keep the dtype of their input.
"""

import torch
from torch import Tensor

__all__ = [
    "align",
    "compose",
    "distance",
    "exp",
    "inverse",
    "log",
    "normalize",
    "relative",
    "rotate",
    "slerp",
    "squared_distance",
    "usable",
]


def usable(q: Tensor) -> Tensor:
    """Whether each quaternion has a direction: finite and not zero.

    Args:
        q: Quaternions ``(..., 4)`` of any norm.

    Returns:
        Booleans ``(...)``.
    """
    largest = q.detach().abs().amax(-1)
    # subnormal numbers have lost their direction, and 1 / subnormal overflows
    return torch.isfinite(largest) & (largest >= torch.finfo(q.dtype).tiny)


def normalize(q: Tensor) -> Tensor:
    """Scale quaternions to unit length; rows without a direction become the identity.

    The largest component is divided out first, so norms from the smallest normal to the largest
    finite number keep their direction. Unusable rows (see :func:`usable`) get zero gradient.

    Args:
        q: Quaternions ``(..., 4)`` of any norm.

    Returns:
        Unit quaternions ``(..., 4)``.
    """
    identity = q.new_tensor([0.0, 0.0, 0.0, 1.0])
    safe = torch.where(usable(q)[..., None], q, identity)
    # a constant factor: the result does not depend on it, so neither does the gradient
    safe = safe / safe.detach().abs().amax(-1, keepdim=True)
    return safe / safe.square().sum(-1, keepdim=True).sqrt()


def exp(v: Tensor) -> Tensor:
    """Unit quaternion of a rotation vector.

    Args:
        v: Rotation vectors ``(..., 3)`` [rad]; any finite length.

    Returns:
        Unit quaternions ``(..., 4)``.
    """
    half = 0.5 * v
    square = half.square().sum(-1, keepdim=True)
    # both series end in h^10 / 10!, below one rounding error under this bound
    small = square < (torch.finfo(v.dtype).eps * 3628800) ** 0.2
    series = torch.where(small, square, 0.0)
    angle = torch.where(small, 1.0, square).sqrt()
    sinc = torch.where(
        small, _horner(series, 1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880), angle.sin() / angle
    )
    cosine = torch.where(
        small, _horner(series, 1, -1 / 2, 1 / 24, -1 / 720, 1 / 40320), angle.cos()
    )
    return torch.cat([sinc * half, cosine], -1)


def log(q: Tensor) -> Tensor:
    """Rotation vector of a unit quaternion, along the short arc.

    Args:
        q: Unit quaternions ``(..., 4)``.

    Returns:
        Rotation vectors ``(..., 3)`` [rad], norm in [0, pi].
    """
    q = torch.where(q[..., 3:] < 0, -q, q)
    vector, w = q[..., :3], q[..., 3:]
    sine_square = vector.square().sum(-1, keepdim=True)
    # atan(x) = x (1 - x^2/3 + ...) ends in x^12 / 13, below one rounding error under this bound
    small = sine_square < (torch.finfo(q.dtype).eps * 13) ** (1 / 6) * w.detach().square()
    w_series = torch.where(small, w, 1.0)
    tangent_square = torch.where(small, sine_square, 0.0) / w_series.square()
    series = _horner(tangent_square, 1, -1 / 3, 1 / 5, -1 / 7, 1 / 9, -1 / 11) / w_series
    sine = torch.where(small, 1.0, sine_square).sqrt()
    factor = torch.where(small, series, torch.atan2(sine, w) / sine)
    return 2.0 * factor * vector


def compose(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product ``a b``: the rotation that applies ``b`` first, then ``a``.

    Args:
        a: Quaternions ``(..., 4)``.
        b: Quaternions ``(..., 4)``.

    Returns:
        Quaternions ``(..., 4)``.
    """
    ax, ay, az, aw = a.unbind(-1)
    bx, by, bz, bw = b.unbind(-1)
    return torch.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        -1,
    )


def inverse(q: Tensor) -> Tensor:
    """Inverse of unit quaternions ``(..., 4)``: the conjugate."""
    return q * q.new_tensor([-1.0, -1.0, -1.0, 1.0])


def relative(a: Tensor, b: Tensor) -> Tensor:
    """The rotation from ``a`` to ``b`` in the body frame of ``a``: ``a^-1 b``.

    Computed as ``1 + a^-1 (b - a)``: the difference of neighbours is exact, so small angles keep
    their relative precision, where the product itself would lose 1e-3 of 1e-4 rad in float32.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Unit quaternions ``(..., 4)``.
    """
    opposite = (a.detach() * b.detach()).sum(-1, keepdim=True) < 0
    difference = compose(inverse(a), torch.where(opposite, -b, b) - a)
    near = difference + a.new_tensor([0.0, 0.0, 0.0, 1.0])
    return torch.where(opposite, -near, near)


def slerp(a: Tensor, b: Tensor, t: float | Tensor) -> Tensor:
    """Turn from ``a`` towards ``b`` by the fraction ``t`` of the short arc.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.
        t: Fraction, broadcastable to ``(..., 1)``; outside [0, 1] it extrapolates.

    Returns:
        Unit quaternions ``(..., 4)``, in the hemisphere of ``a`` for ``t`` in [0, 1].
    """
    return compose(a, exp(t * log(relative(a, b))))


def squared_distance(a: Tensor, b: Tensor) -> Tensor:
    """Squared rotation angle between ``a`` and ``b``; smooth where they are equal.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Squared angles ``(...)`` [rad^2], in [0, pi^2].
    """
    return log(relative(a, b)).square().sum(-1)


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Rotation angle between ``a`` and ``b``; its gradient is 0 where they are equal.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Angles ``(...)`` [rad], in [0, pi].
    """
    # largest component divided out: the square of an angle below 1e-23 underflows in float32
    v = log(relative(a, b))
    largest = v.detach().abs().amax(-1, keepdim=True)
    scale = torch.where(largest > 0, largest, 1.0)
    square = (v / scale).square().sum(-1)
    apart = square > 0
    return torch.where(apart, torch.where(apart, square, 1.0).sqrt() * scale[..., 0], 0.0)


def align(q: Tensor, reference: Tensor) -> Tensor:
    """Choose between ``q`` and ``-q`` the one in the hemisphere of ``reference``.

    Args:
        q: Quaternions ``(..., 4)``.
        reference: Quaternions ``(..., 4)``; a zero row leaves ``q`` as it is.

    Returns:
        Quaternions ``(..., 4)``, the same rotations as ``q``.
    """
    opposite = (q.detach() * reference.detach()).sum(-1, keepdim=True) < 0
    return torch.where(opposite, -q, q)


def rotate(q: Tensor, point: Tensor) -> Tensor:
    """Rotate points actively: ``q p q^-1``.

    Args:
        q: Unit quaternions ``(..., 4)``.
        point: Points ``(..., 3)``.

    Returns:
        Points ``(..., 3)``.
    """
    axis, w = q[..., :3], q[..., 3:]
    axis, w, point = torch.broadcast_tensors(axis, w, point)
    turned = torch.linalg.cross(axis, point)
    return point + 2.0 * (w * turned + torch.linalg.cross(axis, turned))


def _horner(x: Tensor, *coefficients: float) -> Tensor:
    """Polynomial with the constant term first."""
    value = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value
