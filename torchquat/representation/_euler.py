"""Euler angles in any order of axes, differentiable and finite in gimbal lock."""

import math

import torch
from torch import Tensor

from torchquat import so3

__all__ = ["from_quaternion", "is_order", "to_quaternion"]


def is_order(axes: str) -> bool:
    """Whether these are three axes, no two in a row the same: ``ZXY`` (intrinsic), ``zxy``."""
    one_case = axes in (axes.upper(), axes.lower())
    letters = axes.upper()
    return (
        one_case
        and len(letters) == 3
        and set(letters) <= set("XYZ")
        and letters[1] not in (letters[0], letters[2])
    )


def to_quaternion(angles: Tensor, axes: str) -> Tensor:
    """Unit quaternions ``(..., 4)`` of angles ``(..., 3)`` [rad] about ``axes``."""
    turns = [
        _about(axis, angle) for axis, angle in zip(axes.upper(), angles.unbind(-1), strict=True)
    ]
    first, second, third = turns if axes.isupper() else turns[::-1]
    return so3.compose(so3.compose(first, second), third)


def _about(axis: str, angle: Tensor) -> Tensor:
    zero = torch.zeros_like(angle)
    parts = [zero, zero, zero, torch.cos(0.5 * angle)]
    parts["XYZ".index(axis)] = torch.sin(0.5 * angle)
    return torch.stack(parts, -1)


def from_quaternion(q: Tensor, axes: str) -> Tensor:
    """Angles ``(..., 3)`` [rad] about ``axes``, the outer two in (-pi, pi].

    The middle one is in [0, pi] where the first axis is the third, else in [-pi/2, pi/2]. In gimbal
    lock only the sum or the difference of the outer two is defined: the third is 0 there, and what
    is not defined has no gradient.

    Reference:
        Bernardes and Viollet, "Quaternion to Euler angles conversion", PLoS ONE 2022.
    """
    order = ["XYZ".index(axis) for axis in axes.upper()]
    i, j, k = order if axes.islower() else order[::-1]  # extrinsic
    same = i == k
    k = 3 - i - j
    even = (i - j) * (j - k) * (k - i) // 2
    w, x, y, z = q[..., 3], q[..., i], q[..., j], even * q[..., k]
    a, b, c, d = (w, x, y, z) if same else (w - y, x + z, y + w, z - x)

    low, high = a * a + b * b, c * c + d * d
    tiny = torch.finfo(q.dtype).eps ** 2
    no_sum, no_difference = (low <= tiny).detach(), (high <= tiny).detach()
    middle = 2.0 * torch.atan2(_root(high, no_difference), _root(low, no_sum))
    half_sum, half_difference = _angle(b, a, no_sum), _angle(d, c, no_difference)
    # in lock, so that the third angle is 0: it is the difference if intrinsic, else the sum
    side = 1.0 if axes.isupper() else -1.0
    half_difference = torch.where(no_difference, side * half_sum, half_difference)
    half_sum = torch.where(no_sum, side * half_difference, half_sum)

    first, third = half_sum - half_difference, half_sum + half_difference
    if not same:
        third, middle = even * third, middle - 0.5 * math.pi
    angles = [first, middle, third] if axes.islower() else [third, middle, first]
    return torch.stack([_wrapped(angle) for angle in angles], -1)


def _root(square: Tensor, none: Tensor) -> Tensor:
    return torch.where(none, 0.0, torch.where(none, 1.0, square).sqrt())


def _angle(sine: Tensor, cosine: Tensor, none: Tensor) -> Tensor:
    """``atan2``, 0 where both are 0."""
    return torch.atan2(torch.where(none, 0.0, sine), torch.where(none, 1.0, cosine))


def _wrapped(angle: Tensor) -> Tensor:
    """The same angle in (-pi, pi]."""
    turns = torch.ceil((angle.detach() - math.pi) / (2.0 * math.pi))
    return angle - 2.0 * math.pi * turns
