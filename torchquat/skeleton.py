"""A hierarchy of joints, and where its rotations put them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchquat import so3
from torchquat._checks import check_layout

__all__ = ["Skeleton"]


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints in an order in which parents come first.

    Attributes:
        names: One name per joint.
        parents: Index of each joint's parent; -1 for a root.
        offsets: Position of each joint in its parent's frame, ``(J, 3)``, float64, any unit.
        end_sites: Tips of the last bones: pairs of a joint and a position in its frame.

    Raises:
        ValueError: If the lengths differ, a parent does not come before its child, or an end site
            belongs to no joint.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Tensor
    end_sites: tuple[tuple[int, tuple[float, float, float]], ...] = ()

    def __post_init__(self) -> None:
        joints = len(self.names)
        if len(self.parents) != joints or self.offsets.shape != (joints, 3):
            raise ValueError(
                f"names, parents and offsets must be of one length, got {joints}, "
                f"{len(self.parents)} and {tuple(self.offsets.shape)}."
            )
        for joint, parent in enumerate(self.parents):
            if not -1 <= parent < joint:
                raise ValueError(f"parents must be < their joint, got {parent} for {joint}.")
        for joint, _ in self.end_sites:
            if not 0 <= joint < joints:
                raise ValueError(f"end_sites must belong to joints in [0, {joints}), got {joint}.")

    def forward_kinematics(
        self, q: Tensor, root_position: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """World rotations and positions of all joints.

        Args:
            q: Local rotations ``(..., T, J, 4)``, each in its parent's frame.
            root_position: Positions of the first joint ``(..., T, 3)``; ``None``: its offset. Other
                roots lie at their offsets.

        Returns:
            World rotations ``(..., T, J, 4)`` and positions ``(..., T, J, 3)``, in the unit of the
            offsets.

        Raises:
            TypeError: If ``q`` is not a floating-point tensor.
            ValueError: If ``q`` has another shape or number of joints.
        """
        check_layout(q)
        if q.shape[-2] != len(self.names):
            raise ValueError(f"q must have {len(self.names)} joints, got {q.shape[-2]}.")
        kind, work = q.dtype, q.float() if q.dtype.itemsize < 4 else q
        q = so3.normalize(work)
        offsets = self.offsets.to(q)
        if not self.parents:
            return q.to(kind), q[..., :3].to(kind)
        rotations: list[Tensor] = []
        positions: list[Tensor] = []
        for joint, parent in enumerate(self.parents):
            local = q[..., joint, :]
            if parent < 0:
                rotations.append(local)
                place = offsets[joint].expand(*local.shape[:-1], 3)
                followed = root_position if joint == 0 else None
                positions.append(place if followed is None else followed.to(q))
            else:
                rotations.append(so3.compose(rotations[parent], local))
                bone = so3.rotate(rotations[parent], offsets[joint])
                positions.append(positions[parent] + bone)
        return torch.stack(rotations, -2).to(kind), torch.stack(positions, -2).to(kind)

    def tips(self, rotations: Tensor, positions: Tensor) -> Tensor:
        """Positions of the end sites.

        Args:
            rotations: World rotations ``(..., T, J, 4)`` from :meth:`forward_kinematics`.
            positions: World positions ``(..., T, J, 3)`` from there.

        Returns:
            Positions ``(..., T, len(end_sites), 3)``.
        """
        joints = [joint for joint, _ in self.end_sites]
        places = [place for _, place in self.end_sites]
        offset = torch.tensor(places, dtype=positions.dtype, device=positions.device).reshape(-1, 3)
        return positions[..., joints, :] + so3.rotate(rotations[..., joints, :], offset)

    def index(self, names: Sequence[str]) -> list[int]:
        """Indices of joints by name.

        Raises:
            ValueError: If a name is not one of the skeleton's.
        """
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise ValueError(f"joints must be of {list(self.names)}, got {unknown}.")
        return [self.names.index(name) for name in names]
