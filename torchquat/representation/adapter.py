"""A filter of quaternions in the representation that a model speaks."""

import math

import torch
from torch import Tensor, nn

from torchquat import missing
from torchquat._checks import check_count
from torchquat.representation.branch import continuous_rotvec
from torchquat.representation.conversion import Form, check_rotations, form_of, read, write

__all__ = ["RepresentationAdapter"]


class RepresentationAdapter(nn.Module):
    """A filter that takes and gives another representation than quaternions.

    Rotation vectors come back without jumps, see
    :func:`~torchquat.representation.continuous_rotvec`: the first frame on the branch nearest to
    that of the first present frame of the input, every other on the one nearest to the frame
    before. All other
    representations come back as :func:`~torchquat.representation.convert` writes them. Missing
    rotations (see there) come back filled.

    Args:
        filter: Any module with ``forward(q, weight=None)`` on unit quaternions ``(..., T, J, 4)``.
        representation: What :meth:`forward` takes and gives; a name as for
            :func:`~torchquat.representation.convert`.
        joints: ``None``: joints have an axis of their own, as in ``(..., T, J, 3, 3)`` or
            ``(..., T, J, 3)``. A number: rows hold that many joints one after the other, for 24
            ``(..., T, 216)`` or ``(..., T, 72)``. Nothing is guessed from the shape.

    Raises:
        ValueError: If the representation is none, or ``joints`` < 1.
    """

    def __init__(
        self, filter: nn.Module, representation: str, *, joints: int | None = None
    ) -> None:
        super().__init__()
        form_of(representation)
        if joints is not None:
            check_count("joints", joints, 1)
        self.filter = filter
        self.representation = representation
        self.joints = joints

    def forward(self, x: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter rotations in the representation of this module.

        Args:
            x: Rotations, laid out as ``joints`` says; not written to.
            weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.

        Returns:
            Rotations in the shape, dtype and layout of ``x``.

        Raises:
            TypeError: If ``x`` or ``weight`` is not a tensor of a fitting dtype.
            ValueError: If the shape is not that of the representation and ``joints``.
        """
        form = form_of(self.representation)
        rows = _split(x, form, self.joints)
        work = rows.float() if rows.dtype.itemsize < 4 else rows
        if weight is not None and weight.is_floating_point() and weight.dtype == x.dtype:
            weight = weight.to(work.dtype)
        q, present = read(work, form)
        q = torch.where(present[..., None], q, torch.nan)
        result = self.filter(q, weight)
        if form.name == "rotvec":
            start = _first(work, missing.validity(q, weight)) if work.shape[-3] else None
            result = continuous_rotvec(result, start)
        else:
            result = write(result, torch.ones_like(present), form)
        return result.to(x.dtype).reshape(x.shape)

    def extra_repr(self) -> str:
        """Settings, as ``repr`` shows them."""
        return f"{self.representation!r}, joints={self.joints}"


def _first(x: Tensor, present: Tensor) -> Tensor:
    """The first row of every joint that is present ``(..., J, 3)``; the first, if none is."""
    frame = present.to(torch.uint8).argmax(-2, keepdim=True)[..., None]
    return x.gather(-3, frame.expand(*frame.shape[:-1], 3)).squeeze(-3)


def _split(x: Tensor, form: Form, joints: int | None) -> Tensor:
    """Rotations ``(..., T, J, *form.shape)``."""
    if joints is None:
        check_rotations(x, form)
        if x.dim() < 2 + len(form.shape):
            wanted = ", ".join(["...", "T", "J", *map(str, form.shape)])
            raise ValueError(
                f"x must have shape ({wanted}) as {form.name}, got {tuple(x.shape)}. "
                "For rows that hold all joints give their number: joints=24."
            )
        return x
    width = joints * math.prod(form.shape)
    if isinstance(x, Tensor) and (x.dim() < 2 or x.shape[-1] != width):
        raise ValueError(
            f"x must have shape (..., T, {width}) as {form.name} of {joints} joints, "
            f"got {tuple(x.shape)}."
        )
    rows = x.unflatten(-1, (joints, *form.shape)) if isinstance(x, Tensor) else x
    check_rotations(rows, form)
    return rows
