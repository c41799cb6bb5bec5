"""Rotation matrices, and their first two columns, to unit quaternions and back.

What is given need not be orthonormal; it is projected. Entries are divided by the largest one
beforehand, so their size does not matter.
"""

import torch
from torch import Tensor

from torchquat import _planes, so3
from torchquat._eager import derivatives

__all__ = ["columns_to_quaternion", "from_quaternion", "to_quaternion"]


def from_quaternion(q: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)``."""
    x, y, z, w = q.unbind(-1)
    entries = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in entries], -2)


def to_quaternion(m: Tensor) -> Tensor:
    r"""Unit quaternion of the rotation nearest to each matrix (special Procrustes).

    It maximises :math:`\operatorname{tr}(R^T M) = q^T K q` (Horn 1987): the eigenvector of ``K``
    with the largest eigenvalue. Derivatives of an eigenvector are infinite where *other*
    eigenvalues meet, as they do for every rotation; here they come from a Newton step at the
    solution, and stay finite where the nearest rotation is not unique. One step makes the first
    and the second exact: it converges cubically, as ``tr(exp(v)^T S)`` has no cubic term where
    ``S`` is symmetric, which it is at the solution.

    Args:
        m: Finite matrices ``(..., 3, 3)``, not 0.

    Returns:
        Unit quaternions ``(..., 4)`` with ``w >= 0``.
    """
    m = m / m.detach().abs().amax((-1, -2), keepdim=True)
    _, vectors = torch.linalg.eigh(_horn(m.detach()))
    q = vectors[..., -1]
    q = q * _planes.sign_of(q[..., 3:])
    if not derivatives(m):
        return q
    # sums, not products of matrices, which autocast would do in half precision, backward too
    step = _newton_step((from_quaternion(q)[..., :, None] * m[..., None, :]).sum(-3))
    return so3.turn(q, step - step.detach())  # of no length: q is the solution already


def columns_to_quaternion(first: Tensor, second: Tensor) -> Tensor:
    """Unit quaternion of the rotation whose first two columns these become (Gram-Schmidt).

    The first column keeps its direction, the second its half-plane. Columns that are parallel
    leave a turn about them open, and so does one that is 0: some perpendicular direction is taken.

    Args:
        first: Finite vectors ``(..., 3)``.
        second: Finite vectors ``(..., 3)``, not 0 where the first is.

    Returns:
        Unit quaternions ``(..., 4)`` with ``w >= 0``.
    """
    second = second / _largest(second)
    none = first.detach().abs().amax(-1, keepdim=True) < torch.finfo(first.dtype).tiny
    a = _unit(torch.where(none, _perpendicular(second), first))
    b = second - (a * second).sum(-1, keepdim=True) * a
    parallel = b.detach().square().sum(-1, keepdim=True) <= 4.0 * torch.finfo(a.dtype).eps ** 2
    b = _unit(torch.where(parallel, _perpendicular(a), b))
    # rounding of nearly parallel columns is as large as what is left of them
    b = _unit(b - (a * b).sum(-1, keepdim=True) * a)
    return _of_rotation(torch.stack([a, b, torch.linalg.cross(a, b)], -1))


def _of_rotation(r: Tensor) -> Tensor:
    """Unit quaternion, ``w >= 0``, of matrices that are rotations: a row of ``4 q q^T = K + 1``."""
    eye = torch.eye(4, dtype=r.dtype, device=r.device)
    square = _horn(r) + eye
    largest = square.detach().diagonal(dim1=-2, dim2=-1).argmax(-1)
    index = largest[..., None, None].expand(*largest.shape, 1, 4)
    q = square.gather(-2, index)[..., 0, :]
    q = q * q.square().sum(-1, keepdim=True).rsqrt()
    return q * _planes.sign_of(q[..., 3:])


def _unit(v: Tensor) -> Tensor:
    """Vectors of length 1."""
    scaled = v / _largest(v)
    return scaled * scaled.square().sum(-1, keepdim=True).rsqrt()


def _largest(v: Tensor) -> Tensor:
    """The largest component, 1 where all are next to 0; a constant to derivatives."""
    largest = v.detach().abs().amax(-1, keepdim=True)
    return torch.where(largest >= torch.finfo(v.dtype).tiny, largest, 1.0)


def _perpendicular(a: Tensor) -> Tensor:
    """A vector at a right angle to each vector ``(..., 3)`` of about length 1."""
    x, y, z = a.unbind(-1)
    zero = torch.zeros_like(x)
    about_z, about_x = torch.stack([-y, x, zero], -1), torch.stack([zero, -z, y], -1)
    return torch.where((z.detach().abs() < 0.8)[..., None], about_z, about_x)


def _horn(m: Tensor) -> Tensor:
    """Symmetric matrices ``K``, ``(..., 4, 4)``, with ``tr(R^T M) = q^T K q``."""
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in m.unbind(-2))
    rows = [
        [a - e - i, b + d, c + g, h - f],
        [b + d, e - a - i, f + h, c - g],
        [c + g, f + h, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _newton_step(s: Tensor) -> Tensor:
    """Rotation vector that takes ``tr(exp(v)^T S)`` to its maximum, from nearby.

    The slope at ``v = 0`` is the axial vector of ``S``, the curvature ``sym(S) - tr(S)``. A little
    is added to the curvature, so that the step is finite where the maximum is a ridge.
    """
    slope = torch.stack(
        [s[..., 2, 1] - s[..., 1, 2], s[..., 0, 2] - s[..., 2, 0], s[..., 1, 0] - s[..., 0, 1]], -1
    )
    little = torch.finfo(s.dtype).eps ** (2 / 3)
    trace = s.diagonal(dim1=-2, dim2=-1).sum(-1) + little
    eye = torch.eye(3, dtype=s.dtype, device=s.device)
    curvature = trace[..., None, None] * eye - 0.5 * (s + s.mT)
    x, y, z = curvature.unbind(-1)
    yz, zx, xy = torch.linalg.cross(y, z), torch.linalg.cross(z, x), torch.linalg.cross(x, y)
    adjugate = torch.stack([yz, zx, xy], -2)
    return (adjugate * slope[..., None, :]).sum(-1) / (x * yz).sum(-1, keepdim=True)
