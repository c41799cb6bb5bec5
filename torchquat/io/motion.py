"""A motion as the filters see it, with everything else of its file carried along."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from torchquat import missing
from torchquat._checks import check_layout
from torchquat.skeleton import Skeleton

__all__ = ["FormatError", "Motion", "Source"]


class FormatError(ValueError):
    """A file is not what its format promises: ``path:line: expected ..., got ...``."""


class Source(Protocol):
    """What a reader keeps of its file, so that the same format can be written back whole."""

    def render(self, motion: Motion) -> bytes:
        """The file with the rotations of ``motion`` in it; all else as it was read."""
        ...


@dataclass(frozen=True, eq=False)
class Motion:
    """Local rotations of a skeleton over time.

    Attributes:
        q: Rotations ``(T, J, 4)``, ``(x, y, z, w)``, float64, each in its parent's frame.
        frame_rate: Frames per second.
        names: One name per joint.
        skeleton: Hierarchy and offsets where the file has them.
        root_position: Position of the root ``(T, 3)``, in the unit of the offsets.
        weight: Confidence ``(T, J)``; 0 marks a missing frame.
        source: What else the file held, see :func:`torchquat.io.save`.
    """

    q: Tensor
    frame_rate: float
    names: tuple[str, ...]
    skeleton: Skeleton | None = None
    root_position: Tensor | None = None
    weight: Tensor | None = None
    source: Source | None = None

    def __post_init__(self) -> None:
        check_layout(self.q)
        if self.q.dim() != 3 or self.q.shape[1] != len(self.names):
            raise ValueError(
                f"q must have shape (T, {len(self.names)}, 4), got {tuple(self.q.shape)}."
            )
        if not 0 < self.frame_rate < float("inf"):
            raise ValueError(f"frame_rate must be finite and > 0, got {self.frame_rate}.")

    @property
    def valid(self) -> Tensor:
        """Which rotations are present, booleans ``(T, J)``."""
        return missing.validity(self.q, self.weight)

    def with_rotations(self, q: Tensor) -> Motion:
        """The same motion with other rotations: complete ones, so the weights are dropped.

        Args:
            q: Rotations ``(T, J, 4)``.
        """
        if q.shape != self.q.shape:
            raise ValueError(f"q must have shape {tuple(self.q.shape)}, got {tuple(q.shape)}.")
        return replace(self, q=q.detach().to("cpu", torch.float64), weight=None)


def error_at(
    path: Path, line: int, expected: str, got: str, column: int | None = None
) -> FormatError:
    """``path:line[:column]: expected ..., got ...``."""
    place = f"{path}:{line}" if column is None else f"{path}:{line}:{column}"
    return FormatError(f"{place}: expected {expected}, got {got}")
