"""Motion made for tests, and how its rotations are compared."""

import math

import numpy as np
import torch
from torch import Tensor

IDENTITY = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)

BOUND = {torch.float64: 1e-12, torch.float32: 5e-6, torch.float16: 2e-3, torch.bfloat16: 2e-2}
"""Angle that rounding may cost [rad]."""


def random_rotations(
    *shape: int, rng: torch.Generator, dtype: torch.dtype = torch.float64
) -> Tensor:
    """Rotations ``(*shape, 4)`` spread evenly, signs at random."""
    q = torch.randn(*shape, 4, generator=rng, dtype=dtype)
    return q / q.norm(dim=-1, keepdim=True)


def smooth_motion(
    *batch: int,
    frames: int = 20,
    joints: int = 3,
    step: float = 0.2,
    rng: torch.Generator,
    dtype: torch.dtype = torch.float64,
) -> Tensor:
    """A walk on the sphere, ``(*batch, frames, joints, 4)``: steps of about ``step`` [rad].

    Signs are those of a continuous path. Made without the package under test.
    """
    q = [random_rotations(*batch, joints, rng=rng)]
    for _ in range(frames):
        turn = torch.randn(*batch, joints, 4, generator=rng, dtype=torch.float64)
        turn = IDENTITY + 0.5 * step / math.sqrt(3.0) * turn * (1.0 - IDENTITY)
        ahead = torch.einsum("...ij,...j->...i", left_matrix(q[-1]), turn)
        q.append(ahead / ahead.norm(dim=-1, keepdim=True))
    return torch.stack(q, -3)[..., :frames, :, :].to(dtype)


def angle_between(a: Tensor, b: Tensor) -> Tensor:
    """Rotation angles [rad], exact to rounding for small and large ones alike."""
    a, b = a.double(), b.double()
    a, b = a / a.norm(dim=-1, keepdim=True), b / b.norm(dim=-1, keepdim=True)
    apart, together = (a - b).norm(dim=-1), (a + b).norm(dim=-1)
    return 4.0 * torch.atan2(torch.minimum(apart, together), torch.maximum(apart, together))


def assert_same_rotation(actual: Tensor, expected: Tensor, tol: float | None = None) -> None:
    """Equal up to the sign of the quaternion, within ``tol`` [rad] (default: rounding)."""
    assert actual.shape == expected.shape, f"{tuple(actual.shape)} != {tuple(expected.shape)}"
    bound = BOUND[actual.dtype] if tol is None else tol
    angles = angle_between(actual.detach(), expected.detach())
    assert not angles.isnan().any(), "NaN among the rotations"
    worst = angles.max().item() if angles.numel() else 0.0
    assert worst <= bound, f"largest angle {worst:.3g} rad > {bound:.3g}"


def special_orthogonal(rng: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
    """A random rotation of the 3-sphere, ``(4, 4)``: a left and a right multiplication."""
    matrix, _ = torch.linalg.qr(torch.randn(4, 4, generator=rng, dtype=torch.float64))
    matrix[:, 0] *= torch.linalg.det(matrix)
    return matrix.to(dtype)


def left_matrix(q: Tensor) -> Tensor:
    """Matrices ``(..., 4, 4)`` of multiplication from the left, for quaternions ``x, y, z, w``."""
    x, y, z, w = q.unbind(-1)
    rows = [w, -z, y, x, z, w, -x, y, -y, x, w, z, -x, -y, -z, w]
    return torch.stack(rows, -1).reshape(*q.shape[:-1], 4, 4)


def numpy_of(q: Tensor) -> np.ndarray:
    """Float64 array of a tensor."""
    return q.detach().double().numpy()
