"""From one representation of rotations to another."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchquat import so3
from torchquat.representation import _euler, _matrices

__all__ = ["Form", "check_rotations", "convert", "form_of", "read", "write"]


class Form(NamedTuple):
    """A representation: the shape of one rotation, and the way to quaternions and back."""

    name: str
    shape: tuple[int, ...]
    to_quaternion: Callable[[Tensor], Tensor]
    from_quaternion: Callable[[Tensor], Tensor]
    zero_is_missing: bool


def convert(x: Tensor, src: str, dst: str) -> Tensor:
    """Convert rotations from one representation to another.

    ================== ============== ====================================================
    name               shape          numbers
    ================== ============== ====================================================
    ``quat_xyzw``      ``(..., 4)``   ``x, y, z, w``, the order of this package
    ``quat_wxyz``      ``(..., 4)``   ``w, x, y, z``, as PyTorch3D has them
    ``rotvec``         ``(..., 3)``   axis times angle [rad] ("axis-angle" of SMPL)
    ``rotmat``         ``(..., 3, 3)`` ``R``, which acts on column vectors
    ``rot6d``          ``(..., 6)``   first two *columns*, ``R[:, :2]`` row by row:
                                      ``R00 R01 R10 R11 R20 R21`` (HMR, SPIN, VIBE, WHAM)
    ``rot6d_columns``  ``(..., 6)``   the same columns one after the other:
                                      ``R00 R10 R20 R01 R11 R21`` (4D-Humans, Zhou et al.)
    ``rot6d_rows``     ``(..., 6)``   first two *rows*: ``R00 R01 R02 R10 R11 R12``
                                      (PyTorch3D, and so GVHMR)
    ``euler:ZXY``      ``(..., 3)``   angles [rad] about the axes named, in their order:
                                      upper case intrinsic, lower case extrinsic, as in scipy
    ``euler:ZXY_deg``  ``(..., 3)``   the same in degrees
    ================== ============== ====================================================

    Rotations come back the same to rounding, near half turns and in gimbal lock too. Rotation
    vectors come back with an angle of at most pi, Euler angles in their principal ranges, and in
    gimbal lock with a third angle of 0 (:func:`continuous_rotvec` keeps vectors from jumping).
    Quaternions may have any norm; one order of components to the other keeps it, and the sign.

    What is not a rotation is projected: ``rotmat`` to the nearest one (special Procrustes), the
    two vectors of a ``rot6d`` by Gram-Schmidt, as the networks that put it out do. First and second
    derivatives are finite everywhere; where a rotation does not define an angle or an axis, that
    has no gradient.

    A missing rotation - a number that is not finite, or all of them 0 in a quaternion, matrix or
    ``rot6d`` - comes back as NaN, has no gradient, and does not touch any other.

    Args:
        x: Rotations in the representation ``src``; not written to.
        src: Its name.
        dst: Name of the representation wanted; ``x`` itself where it is ``src``.

    Returns:
        Rotations in the dtype of ``x``.

    Raises:
        TypeError: If ``x`` is not a floating-point tensor.
        ValueError: If a name is not one of these, or the shape is not that of ``src``.
    """
    source, target = form_of(src), form_of(dst)
    check_rotations(x, source)
    if src == dst:
        return x
    if {src, dst} == {"quat_xyzw", "quat_wxyz"}:
        return source.to_quaternion(x) if dst == "quat_xyzw" else target.from_quaternion(x)
    work = x.float() if x.dtype.itemsize < 4 else x
    q, present = read(work, source)
    return write(q, present, target).to(x.dtype)


def read(x: Tensor, form: Form) -> tuple[Tensor, Tensor]:
    """Unit quaternions ``(..., 4)``, the identity where missing, and which are present."""
    entries = x.flatten(-2) if len(form.shape) == 2 else x
    square = entries.detach().square().sum(-1)
    present = torch.isfinite(entries.detach()).all(-1)
    if form.zero_is_missing:
        present = present & so3.usable(entries)
    else:
        present = present & torch.isfinite(square)  # the sine of an angle that overflows is NaN
    identity = form.from_quaternion(
        torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=x.dtype, device=x.device)
    )
    safe = torch.where(_like(present, form), x, identity)
    return so3.normalize(form.to_quaternion(safe)), present


def write(q: Tensor, present: Tensor, form: Form) -> Tensor:
    """Unit quaternions in a representation, NaN where missing."""
    x = form.from_quaternion(q)
    return torch.where(_like(present, form), x, torch.nan)


def form_of(name: str) -> Form:
    """The representation of a name.

    Raises:
        ValueError: If there is none of it.
    """
    if not isinstance(name, str):
        raise TypeError(f"a representation must be named by a string, got {name!r}.")
    if name in _FORMS:
        return _FORMS[name]
    kind, _, axes = name.partition(":")
    degrees = axes.endswith("_deg")
    axes = axes.removesuffix("_deg")
    if kind != "euler" or not _euler.is_order(axes):
        raise ValueError(
            f"a representation must be one of {', '.join(_FORMS)} or euler:ZXY (three axes, "
            f"neighbours different, all upper or all lower case; euler:ZXY_deg), got {name!r}."
        )
    return Form(
        name,
        (3,),
        lambda x: _euler.to_quaternion(torch.deg2rad(x) if degrees else x, axes),
        lambda q: (torch.rad2deg if degrees else torch.clone)(_euler.from_quaternion(q, axes)),
        zero_is_missing=False,
    )


def check_rotations(x: Tensor, form: Form) -> None:
    """Raise unless ``x`` is a floating-point tensor of rotations in this representation."""
    if not isinstance(x, Tensor):
        raise TypeError(f"x must be a torch.Tensor, got {type(x).__name__}.")
    if not x.is_floating_point():
        raise TypeError(f"x must be a floating-point tensor, got {x.dtype}.")
    if tuple(x.shape[-len(form.shape) :]) != form.shape:
        wanted = ", ".join(["...", *map(str, form.shape)])
        raise ValueError(f"x must have shape ({wanted}) as {form.name}, got {tuple(x.shape)}.")


def _like(present: Tensor, form: Form) -> Tensor:
    return present[(..., *([None] * len(form.shape)))]


def _from_rot6d(x: Tensor) -> Tensor:
    return _matrices.columns_to_quaternion(x[..., 0::2], x[..., 1::2])


def _from_columns(x: Tensor) -> Tensor:
    return _matrices.columns_to_quaternion(x[..., :3], x[..., 3:])


def _from_rows(x: Tensor) -> Tensor:
    """Rows are the columns of the inverse."""
    return so3.inverse(_from_columns(x))


def _to_rot6d(q: Tensor) -> Tensor:
    return _matrices.from_quaternion(q)[..., :2].flatten(-2)


def _to_columns(q: Tensor) -> Tensor:
    return _matrices.from_quaternion(q)[..., :2].mT.flatten(-2)


def _to_rows(q: Tensor) -> Tensor:
    return _matrices.from_quaternion(q)[..., :2, :].flatten(-2)


def _same(q: Tensor) -> Tensor:
    return q


_FORMS = {
    form.name: form
    for form in (
        Form("quat_xyzw", (4,), _same, _same, True),
        Form("quat_wxyz", (4,), lambda x: x.roll(-1, -1), lambda q: q.roll(1, -1), True),
        Form("rotvec", (3,), so3.exp, so3.log, False),
        Form("rotmat", (3, 3), _matrices.to_quaternion, _matrices.from_quaternion, True),
        Form("rot6d", (6,), _from_rot6d, _to_rot6d, True),
        Form("rot6d_columns", (6,), _from_columns, _to_columns, True),
        Form("rot6d_rows", (6,), _from_rows, _to_rows, True),
    )
}
