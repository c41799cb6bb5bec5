"""Euler angles of motion files: any rotation order, without jumps."""

from types import ModuleType

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["euler_to_quaternion", "nearest_euler"]

Array = NDArray[np.float64]

_LOCK = 1e-9  # [rad] from gimbal lock: the first angle is noise there, an error of it harmless


def euler_to_quaternion(angles_deg: Array, axes: str) -> Tensor:
    """Quaternions of intrinsic rotations in the order of the channels.

    Args:
        angles_deg: Angles ``(..., len(axes))`` [deg].
        axes: One to three of ``X``, ``Y``, ``Z``.

    Returns:
        Unit quaternions ``(..., 4)``, float64.
    """
    angles = torch.from_numpy(np.deg2rad(angles_deg))
    return _roma().euler_to_unitquat(axes, angles)


def nearest_euler(q: Tensor, axes: str, start_deg: Array) -> Array:
    """Euler angles that move as little as can be from frame to frame.

    Every rotation has two solutions, ``(a, b, c)`` and ``(a + 180, 180 - b, c + 180)``, each up to
    full turns; the one nearest to the frame before is taken. In gimbal lock the first angle holds.

    Args:
        q: Unit quaternions ``(T, J, 4)``, float64.
        axes: One to three different ones of ``X``, ``Y``, ``Z``, in the order of the channels. With
            fewer than three, the rotation about the others is dropped.
        start_deg: Angles that the first frame should be near to, ``(J, len(axes))`` [deg].

    Returns:
        Angles ``(T, J, len(axes))`` [deg].
    """
    order = axes + "".join(axis for axis in "XYZ" if axis not in axes)
    start = np.zeros((*start_deg.shape[:-1], 3))
    start[..., : len(axes)] = np.deg2rad(start_deg)
    first = np.asarray(_roma().unitquat_to_euler(order, q, epsilon=1e-12))
    first = np.concatenate([start[None], _leave_lock(q, first, order, start)])
    second = np.stack([first[..., 0] + np.pi, np.pi - first[..., 1], first[..., 2] + np.pi], -1)

    switch = _turn(first[1:], first[:-1]) > _turn(second[1:], first[:-1])
    on_second = np.logical_xor.accumulate(switch, axis=0)[..., None]
    chosen = np.concatenate([start[None], np.where(on_second, second[1:], first[1:])])
    return np.rad2deg(np.unwrap(chosen, axis=0)[1:, ..., : len(axes)])


def _roma() -> ModuleType:
    """Imported when first needed: it loads PyTorch's compiler, which takes as long as PyTorch."""
    import roma

    return roma


def _turn(angles: Array, before: Array) -> Array:
    """Sum over the three axes of the turns between two frames, full turns not counted."""
    difference = angles - before
    return np.abs(difference - 2 * np.pi * np.round(difference / (2 * np.pi))).sum(-1)


def _leave_lock(q: Tensor, angles: Array, order: str, start: Array) -> Array:
    """Replace the first angle in gimbal lock by that of the frame before, the third to match."""
    locked = np.abs(np.abs(angles[..., 1]) - np.pi / 2) < _LOCK
    if not locked.any():
        return angles
    frame = np.where(locked, -1, np.arange(len(angles))[:, None])
    held = np.maximum.accumulate(frame, axis=0)
    known = np.take_along_axis(angles[..., 0], np.maximum(held, 0), axis=0)
    first = np.where(locked, np.where(held >= 0, known, start[..., 0]), angles[..., 0])
    roma = _roma()
    two = torch.from_numpy(np.stack([first, angles[..., 1]], -1))
    rest = roma.quat_product(roma.quat_inverse(roma.euler_to_unitquat(order[:2], two)), q)
    twist = 2.0 * torch.atan2(rest[..., "XYZ".index(order[2])], rest[..., 3]).numpy()
    return np.stack([first, angles[..., 1], np.where(locked, twist, angles[..., 2])], -1)
