"""Rotations as unit quaternions, with finite first and second derivatives everywhere.

Convention of the whole package: components ``(x, y, z, w)``, Hamilton product, active rotations;
``compose(a, b)`` applies ``b`` first. A rotation vector lives in the body frame,
``q1 = compose(q0, exp(v))``, and its norm is the rotation angle [rad]. ``q`` and ``-q`` are the
same rotation: ``log``, ``distance`` and ``slerp`` always take the short arc.

All functions broadcast over the leading axes and keep the dtype of their input.
"""

import torch
from torch import Tensor

from torchquat import _operations, _planes
from torchquat._eager import derivatives, highest, lowest

__all__ = [
    "align",
    "between",
    "compose",
    "distance",
    "exp",
    "inverse",
    "log",
    "midpoint",
    "normalize",
    "normalized_if_ordinary",
    "relative",
    "rotate",
    "slerp",
    "squared_distance",
    "turn",
    "turn_both_ways",
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
    plain = normalized_if_ordinary(q)
    if plain is not None:
        return plain
    identity = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=q.dtype, device=q.device)
    safe = torch.where(usable(q)[..., None], q, identity)
    # a constant factor: the result does not depend on it, so neither does the gradient
    scaled = safe / safe.detach().abs().amax(-1, keepdim=True)
    careful = scaled * _squared_norm(scaled).rsqrt()[..., None]
    # bit by bit what it would be if all rows were ordinary: one wrong frame must not reach others
    low, high = _ordinary_range(q.dtype)
    square = _squared_norm(q)
    common = ((square > low) & (square < high)).detach()[..., None]
    plain = torch.where(common, q, identity)
    return torch.where(common, plain * _squared_norm(plain).rsqrt()[..., None], careful)


def normalized_if_ordinary(q: Tensor) -> Tensor | None:
    """Unit quaternions, if all can be seen to be neither wrong nor near an overflow.

    Args:
        q: Quaternions ``(..., 4)`` of any norm.

    Returns:
        Unit quaternions ``(..., 4)``, their components one after the other in memory; or ``None``.
    """
    planes = _operations.split(q)
    own = [plane.detach() for plane in planes]
    square = _planes.dot(own, own)
    low, high = _ordinary_range(q.dtype)
    if not (lowest(square) > low and highest(square) < high):
        return None
    if derivatives(q):
        return _planes.join(_operations.normalized(planes))
    return _planes.join(own).mul_(square.rsqrt()[..., None])


def _squared_norm(q: Tensor) -> Tensor:
    """Sum of the squared components of ``(..., 4)``, shape ``(...)``; may overflow."""
    return _planes.dot(q.unbind(-1), q.unbind(-1))


def _ordinary_range(dtype: torch.dtype) -> tuple[float, float]:
    """Between these, a squared norm has all its digits."""
    limits = torch.finfo(dtype)
    return limits.tiny / limits.eps, limits.max * limits.eps


def exp(v: Tensor) -> Tensor:
    """Unit quaternion of a rotation vector.

    Args:
        v: Rotation vectors ``(..., 3)`` [rad], whose squared length is finite: up to 1e19 in single
            precision. Angles are as good as the digits of the length.

    Returns:
        Unit quaternions ``(..., 4)``.
    """
    x, y, z = v.unbind(-1)
    return _planes.join(_planes.exp((x, y, z)))


def log(q: Tensor) -> Tensor:
    """Rotation vector of a unit quaternion, along the short arc.

    Args:
        q: Unit quaternions ``(..., 4)``.

    Returns:
        Rotation vectors ``(..., 3)`` [rad], norm in [0, pi].
    """
    x, y, z, w = q.unbind(-1)
    return _planes.join(_planes.log(_planes.upper((x, y, z, w))))


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
    return _planes.join(_planes.compose((ax, ay, az, aw), (bx, by, bz, bw)))


def inverse(q: Tensor) -> Tensor:
    """Inverse of unit quaternions ``(..., 4)``: the conjugate."""
    return q * torch.tensor([-1.0, -1.0, -1.0, 1.0], dtype=q.dtype, device=q.device)


def relative(a: Tensor, b: Tensor) -> Tensor:
    """The rotation from ``a`` to ``b`` in the body frame of ``a``: ``a^-1 b``.

    Small angles keep their relative precision.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Unit quaternions ``(..., 4)``, of both signs the one with ``w >= 0``.
    """
    b = align(b, a)
    ax, ay, az, aw = a.unbind(-1)
    bx, by, bz, bw = b.unbind(-1)
    return _planes.join(_planes.relative((ax, ay, az, aw), (bx, by, bz, bw)))


def between(a: Tensor, b: Tensor) -> Tensor:
    """Rotation vector from ``a`` to ``b`` in the body frame of ``a``: ``log(a^-1 b)``.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Rotation vectors ``(..., 3)`` [rad], norm in [0, pi].
    """
    return _planes.join(_operations.between(_planes.split(a), _planes.split(align(b, a))))


def turn(q: Tensor, v: Tensor) -> Tensor:
    """Turn ``q`` by a rotation vector in its body frame: ``q exp(v)``.

    Args:
        q: Unit quaternions ``(..., 4)``.
        v: Rotation vectors ``(..., 3)`` [rad], of lengths as for :func:`exp`.

    Returns:
        Unit quaternions ``(..., 4)``, each in the hemisphere of its ``q``.
    """
    x, y, z = v.unbind(-1)
    return _planes.join(_operations.turned(_planes.split(q), (x, y, z)))


def turn_both_ways(q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """:func:`turn` by a rotation vector and by its opposite: ``q exp(v)``, ``q exp(-v)``."""
    x, y, z = v.unbind(-1)
    ahead, back = _operations.turned_both_ways(_planes.split(q), (x, y, z))
    return _planes.join(ahead), _planes.join(back)


def midpoint(a: Tensor, b: Tensor) -> Tensor:
    """The middle of the short arc from ``a`` to ``b``.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Unit quaternions ``(..., 4)``, in the hemisphere of ``a``.
    """
    sums = (x + y for x, y in zip(_planes.split(a), _planes.split(align(b, a)), strict=True))
    x, y, z, w = sums
    return _planes.join(_operations.normalized((x, y, z, w)))


def slerp(a: Tensor, b: Tensor, t: float | Tensor) -> Tensor:
    """Turn from ``a`` towards ``b`` by the fraction ``t`` of the short arc.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.
        t: Fraction, broadcastable to ``(..., 1)``; outside [0, 1] it extrapolates.

    Returns:
        Unit quaternions ``(..., 4)``, in the hemisphere of ``a``.
    """
    return turn(a, t * between(a, b))


def squared_distance(a: Tensor, b: Tensor) -> Tensor:
    """Squared rotation angle between ``a`` and ``b``; smooth where they are equal.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Squared angles ``(...)`` [rad^2], in [0, pi^2].
    """
    return _operations.squared_angle(_planes.split(a), _planes.split(b))


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Rotation angle between ``a`` and ``b``; its gradient is 0 where they are equal.

    Args:
        a: Unit quaternions ``(..., 4)``.
        b: Unit quaternions ``(..., 4)``.

    Returns:
        Angles ``(...)`` [rad], in [0, pi].
    """
    # largest component divided out: the square of an angle below 1e-23 underflows in float32
    v = between(a, b)
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
        Quaternions ``(..., 4)`` of the shape of both together, the same rotations as ``q``.
    """
    cosine = _planes.dot(q.detach().unbind(-1), reference.detach().unbind(-1))
    if lowest(cosine) >= 0:
        return q.expand(*cosine.shape, 4)
    return _planes.sign_of(cosine)[..., None] * q


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
