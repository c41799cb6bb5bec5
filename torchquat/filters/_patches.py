"""Distances between patches of frames: one squared difference per lag and a running sum."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torchquat import _operations, _planes, so3

__all__ = ["Groups", "Neighbour", "Patches", "box_sum", "check_groups", "features", "members"]

Groups = Literal["pose", "joint"] | Sequence[int]
"""Joints that share weights: all, none, or those with the same number."""


class Neighbour(NamedTuple):
    """What every frame of a block sees a certain number of frames away.

    Attributes:
        distance: Of the patches [rad^2], ``(..., T, J)``, or one column for all joints.
        votes: Weight of the neighbour before the kernel ``(..., T, J)``, 0 where nothing can be
            compared; ``None``: 1.
        factor: What turns the vector part of the quotient of both into the rotation vector between
            them; ``None`` where logarithms are compared.
        place: Components of the neighbour itself, ``(..., T, J)`` each.
    """

    distance: Tensor
    votes: Tensor | None
    factor: Tensor | None
    place: tuple[Tensor, ...]


@dataclass(frozen=True)
class Patches:
    """Which patches are compared, and how.

    A patch is never gathered: for one lag, the squared difference of every pair of frames is
    computed once, and a running sum over time turns it into the distance of every pair of patches.

    Attributes:
        members: Joints of every group; ``None`` where each joint is its own.
        patch_radius: R, half-width of a patch [frames].
        search_radius: S, largest lag [frames].
        causal: Patches end at their frame, and neighbours lie in the past.
    """

    members: list[list[int]] | None
    patch_radius: int
    search_radius: int
    causal: bool

    @property
    def reach(self) -> int:
        """Frames on either side of a block that are read."""
        return self.patch_radius + self.search_radius

    @property
    def width(self) -> int:
        """Frames of a patch."""
        return self.patch_radius + 1 if self.causal else 2 * self.patch_radius + 1

    def neighbours(
        self, window: Sequence[Tensor], trust: Tensor | None, learned: Tensor | None
    ) -> Iterator[Neighbour]:
        """All neighbours of a block, lag by lag.

        Args:
            window: Components ``(..., T + 2 (R + S), J)`` of unit quaternions, compared in the
                local chart, or three of their logarithms, compared as vectors.
            trust: Confidences of these frames; ``None``: 1.
            learned: Features of their patches, ``(..., T + 2 S, F)``, added to the distance.
        """
        frames = window[0].shape[-2] - 2 * self.reach
        for lag in range(1, self.search_radius + 1):
            start, pairs = self.search_radius - lag, frames + lag
            spanned = pairs + 2 * self.patch_radius
            near, far = ([x.narrow(-2, n, spanned) for x in window] for n in (start, start + lag))
            square, factor = _compared(near, far)
            both = None if trust is None else _pairs(trust, start, lag, spanned)
            distance, common = self._distance(square, both, pairs)
            if learned is not None:
                distance = distance + _unlike(learned, start, lag, pairs)
            for side in (-1,) if self.causal else (-1, 1):
                row = 0 if side < 0 else lag
                votes = None
                if trust is not None and common is not None:
                    votes = trust.narrow(-2, self.reach + side * lag, frames)
                    votes = torch.where(common.narrow(-2, row, frames) > 0, votes, 0.0)
                own = self.patch_radius + row
                yield Neighbour(
                    distance.narrow(-2, row, frames),
                    votes,
                    None if factor is None else factor.narrow(-2, own, frames),
                    tuple(x.narrow(-2, self.reach + side * lag, frames) for x in window),
                )

    def _distance(
        self, square: Tensor, both: Tensor | None, pairs: int
    ) -> tuple[Tensor, Tensor | None]:
        """Distances of pairs of patches and how much they have in common (``None``: all)."""
        if both is None:
            total = box_sum(self.grouped(square), self.width).narrow(-2, 0, pairs)
            return self.spread(total / (3.0 * self.width * self.sizes(total))), None
        total, common = (
            box_sum(self.grouped(x), self.width).narrow(-2, 0, pairs) for x in (square * both, both)
        )
        distance = total / torch.where(common > 0, 3.0 * common, 1.0)
        return self.spread(distance), self.spread(common)

    def sizes(self, like: Tensor) -> float | Tensor:
        """Joints of every group."""
        if self.members is None:
            return 1.0
        if len(self.members) == 1:
            return float(max(len(self.members[0]), 1))
        return torch.tensor(
            [len(joints) for joints in self.members], dtype=like.dtype, device=like.device
        )

    def grouped(self, x: Tensor) -> Tensor:
        """Sum over the joints of every group: ``(..., N, J)`` to ``(..., N, G)``."""
        if self.members is None:
            return x
        if len(self.members) == 1:
            return x.sum(-1, keepdim=True)
        return torch.stack([x[..., joints].sum(-1) for joints in self.members], -1)

    def spread(self, x: Tensor) -> Tensor:
        """Give every joint the value of its group: ``(..., N, G)`` to ``(..., N, J or 1)``."""
        if self.members is None or len(self.members) == 1:
            return x
        group = {joint: g for g, joints in enumerate(self.members) for joint in joints}
        return x[..., [group[joint] for joint in sorted(group)]]


def _compared(first: Sequence[Tensor], second: Sequence[Tensor]) -> tuple[Tensor, Tensor | None]:
    """Squared differences [rad^2] of quaternions, with their factors, or of logarithms."""
    if len(first) == 3:
        difference = [b - a for a, b in zip(first, second, strict=True)]
        return _planes.dot(difference, difference), None
    (ax, ay, az, aw), (bx, by, bz, bw) = first, second
    return _operations.apart((ax, ay, az, aw), (bx, by, bz, bw))


def _unlike(learned: Tensor, start: int, lag: int, pairs: int) -> Tensor:
    """Mean squared differences of features ``(..., pairs, 1)``."""
    near, far = (learned.narrow(-2, n, pairs) for n in (start, start + lag))
    return (far - near).square().mean(-1, keepdim=True)


def _pairs(trust: Tensor, start: int, lag: int, pairs: int) -> Tensor:
    """Confidence of both frames together."""
    return trust.narrow(-2, start, pairs) * trust.narrow(-2, start + lag, pairs)


def features(
    embedding: Callable[[Tensor], Tensor], padded: Tensor, trust: Tensor, patches: Patches
) -> Tensor:
    """Features of the patches of all frames, ``(..., T + 2 S, F)``.

    Args:
        embedding: See :func:`nonlocal_pose_means`.
        padded: Unit quaternions ``(..., T + 2 (R + S), J, 4)`` or their logarithms.
        trust: Confidences ``(..., T + 2 (R + S), J)``.
        patches: Which.

    Raises:
        ValueError: If the embedding gives something else than features ``(..., N, F)``.
    """
    radius = patches.patch_radius
    count = padded.shape[-3] - 2 * radius
    places = range(patches.width)
    patch = torch.stack([padded.narrow(-3, p, count) for p in places], -3)
    present = torch.stack([trust.narrow(-2, p, count) for p in places], -2) > 0
    if patch.shape[-1] == 4:
        centre = padded.narrow(-3, radius, count)[..., None, :, :]
        patch = so3.between(centre, patch)
        # relative to a missing frame, nothing is known
        present = present & present[..., radius : radius + 1, :]
    found = embedding(torch.where(present[..., None], patch, 0.0))
    if found.shape[:-1] != patch.shape[:-3]:
        raise ValueError(
            f"embedding must give features {(*patch.shape[:-3], 'F')}, got {tuple(found.shape)}."
        )
    return found


def box_sum(x: Tensor, width: int) -> Tensor:
    """Sum over ``width`` rows in a row, ``(..., N, G)`` to ``(..., N - width + 1, G)``.

    By doubling: a difference of cumulative sums would lose what is small against the whole.
    """
    result, offset, power = None, 0, 1
    count = x.shape[-2] - width + 1
    while True:
        if width & power:
            part = x.narrow(-2, offset, count)
            result = part if result is None else result + part
            offset += power
        if 2 * power > width:
            assert result is not None
            return result
        rows = x.shape[-2] - power
        x = x.narrow(-2, 0, rows) + x.narrow(-2, power, rows)
        power *= 2


def check_groups(groups: Groups) -> None:
    """Raise unless ``groups`` is a name or a number for every joint."""
    if isinstance(groups, str):
        if groups not in ("pose", "joint"):
            raise ValueError(
                f"groups must be pose, joint, or a number for every joint, got {groups!r}."
            )
        return
    if not isinstance(groups, Sequence) or not all(
        isinstance(number, int) and not isinstance(number, bool) for number in groups
    ):
        raise TypeError(f"groups must be pose, joint, or a number for every joint, got {groups!r}.")


def members(groups: Groups, joints: int) -> list[list[int]] | None:
    """Joints of every group; ``None`` where each joint is its own."""
    if groups == "joint":
        return None
    numbers = [0] * joints if groups == "pose" else list(groups)
    if len(numbers) != joints:
        raise ValueError(
            f"groups must have a number for each of {joints} joints, got {len(numbers)}."
        )
    return [[j for j, own in enumerate(numbers) if own == g] for g in dict.fromkeys(numbers)] or [
        []
    ]
