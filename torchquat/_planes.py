"""Rotations component by component: the arithmetic of :mod:`torchquat.so3` and of the filters.

A quaternion is a tuple of four tensors ``(x, y, z, w)``, a vector one of three; all broadcast. On
planes that lie in memory one after the other every operation runs at the speed of the cache, which
operations along a last axis of length four do not.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat._eager import derivatives, lowest
from torchquat._running import running_product
from torchquat._series import angle_over_half_sine, sinc_and_cosine

__all__ = [
    "Quaternion",
    "Vector",
    "align_path",
    "aligned",
    "by_vector",
    "components",
    "compose",
    "cut",
    "dot",
    "exp",
    "join",
    "log",
    "packed",
    "relative",
    "sign_of",
    "signed",
    "split",
    "stacked",
    "upper",
    "vector_part",
]

Quaternion = tuple[Tensor, Tensor, Tensor, Tensor]
Vector = tuple[Tensor, Tensor, Tensor]


def split(q: Tensor) -> Quaternion:
    """Components of quaternions ``(..., 4)``, one after the other in memory."""
    return components(stacked(q))


def stacked(q: Tensor) -> Tensor:
    """:func:`split`, in one tensor ``(4, ...)``."""
    if torch.compiler.is_compiling() or q.stride(-1) == 1:  # they lie side by side
        return torch.stack(q.unbind(-1))
    return q.movedim(-1, 0)


def components(q: Tensor) -> Quaternion:
    """Components of quaternions ``(4, ...)`` that lie one after the other already."""
    x, y, z, w = q.unbind(0)
    return x, y, z, w


def join(parts: Sequence[Tensor]) -> Tensor:
    """Tensor ``(..., 4)`` or ``(..., 3)`` of components, broadcast against each other.

    The components still lie one after the other in memory, so that what comes next finds them so;
    not in a compiler, which would tie the program to the strides that it has seen.
    """
    joined = torch.stack(torch.broadcast_tensors(*parts)).movedim(0, -1)
    return joined.contiguous() if torch.compiler.is_compiling() else joined


def packed(parts: Sequence[Tensor]) -> Tensor:
    """:func:`join`, but with the components of each quaternion side by side in memory."""
    if derivatives(*parts):
        return join(parts).contiguous()
    result = parts[0].new_empty((*parts[0].shape, len(parts)))
    for component, plane in enumerate(parts):  # with nothing between it and its place
        result[..., component] = plane
    return result


def cut(q: Quaternion, start: int, frames: int) -> Quaternion:
    """Frames of planes ``(..., N, J)``."""
    x, y, z, w = (plane.narrow(-2, start, frames) for plane in q)
    return x, y, z, w


def dot(a: Sequence[Tensor], b: Sequence[Tensor]) -> Tensor:
    """Scalar product."""
    return signed(*zip(a, b, strict=True))


def compose(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product ``a b``."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        signed((aw, bx), (ax, bw), (ay, bz), (-1, az, by)),
        signed((aw, by), (ay, bw), (az, bx), (-1, ax, bz)),
        signed((aw, bz), (ax, by), (az, bw), (-1, ay, bx)),
        signed((aw, bw), (-1, ax, bx), (-1, ay, by), (-1, az, bz)),
    )


def vector_part(a: Sequence[Tensor], b: Sequence[Tensor]) -> Vector:
    """Vector part of ``a^-1 b``; the same for ``b - a`` in place of ``b``."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        signed((aw, bx), (az, by), (-1, ax, bw), (-1, ay, bz)),
        signed((aw, by), (ax, bz), (-1, ay, bw), (-1, az, bx)),
        signed((aw, bz), (ay, bx), (-1, az, bw), (-1, ax, by)),
    )


def by_vector(q: Sequence[Tensor], v: Sequence[Tensor]) -> Quaternion:
    """``q v``, of a quaternion and one without a scalar part."""
    x, y, z, w = q
    a, b, c = v
    return (
        signed((w, a), (y, c), (-1, z, b)),
        signed((w, b), (z, a), (-1, x, c)),
        signed((w, c), (x, b), (-1, y, a)),
        signed((x, a), (y, b), (z, c)).neg_(),
    )


def relative(a: Quaternion, b: Quaternion) -> Quaternion:
    """``a^-1 b``, precise for near rotations, which must lie in one hemisphere for that.

    Computed as ``1 + a^-1 (b - a)``: the difference of neighbours is exact, so small angles keep
    their relative precision, where the product itself would lose 1e-3 of 1e-4 rad in float32.
    """
    step = [second - first for first, second in zip(a, b, strict=True)]
    return *vector_part(a, step), dot(a, step) + 1.0


def log(q: Quaternion) -> Vector:
    """Rotation vector of unit quaternions with ``w >= 0`` [rad]."""
    x, y, z, w = q
    short = w - 1.0
    factor = angle_over_half_sine(0.25 * dot((x, y, z, short), (x, y, z, short)))
    return factor * x, factor * y, factor * z


def exp(v: Vector) -> Quaternion:
    """Unit quaternion of a rotation vector [rad] of any finite length."""
    x, y, z = v
    sinc, cosine = sinc_and_cosine(0.25 * dot(v, v))
    half = 0.5 * sinc
    return half * x, half * y, half * z, cosine


def upper(q: Quaternion) -> Quaternion:
    """Choose the signs so that ``w >= 0``."""
    if lowest(q[3]) >= 0:
        return q
    sign = sign_of(q[3])
    x, y, z, w = (sign * plane for plane in q)
    return x, y, z, w


def sign_of(x: Tensor) -> Tensor:
    """-1 where ``x`` is negative, else 1; it has no gradient."""
    return 1.0 - 2.0 * (x.detach() < 0).to(x.dtype)


def align_path(q: Tensor) -> Tensor:
    """Choose the signs along time so that every frame lies in the hemisphere of the one before.

    Components ``(4, ..., N, J)``.
    """
    frames = q.shape[-2] - 1
    here, there = (q.detach().narrow(-2, start, frames).unbind(0) for start in (0, 1))
    step = dot(here, there)
    if lowest(step) >= 0:
        return q
    sign = running_product(sign_of(step), -2)
    return torch.cat([torch.ones_like(q[0].narrow(-2, 0, 1)), sign], -2) * q


def aligned(q: Tensor, reference: Tensor) -> Tensor:
    """Choose between ``q`` and ``-q`` the one in the hemisphere of ``reference``, ``(4, ...)``."""
    cosine = dot(q.detach().unbind(0), reference.detach().unbind(0))
    return q if lowest(cosine) >= 0 else sign_of(cosine) * q


def signed(*products: tuple[Tensor, Tensor] | tuple[int, Tensor, Tensor]) -> Tensor:
    """Sum of products; a leading -1 subtracts one."""
    first, *rest = products
    total = first[0] * first[1]
    # into the same memory where no derivative needs it: a third faster
    place = None if derivatives(total) else total
    for product in rest:
        *sign, p, r = product
        total = torch.addcmul(total, p, r, value=sign[0] if sign else 1, out=place)
    return total
