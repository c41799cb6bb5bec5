"""Distances between patches of frames: one squared difference per lag and a running mean."""

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import torch
from torch import Tensor

from torchquat import so3

__all__ = ["Groups", "PatchDistances", "box_sum", "check_groups"]

Groups = Literal["pose", "joint"] | Sequence[int]
"""Joints that share weights: all, none, or those with the same number."""


class PatchDistances:
    """Mean squared differences between the patch of every frame and those of its neighbours.

    A patch is never gathered: for one lag, the squared difference of every pair of frames is
    computed once, and a running sum over time turns it into the distance of every pair of patches.

    Args:
        padded: Unit quaternions ``(..., T + 2 (R + S), J, 4)``, compared in the local chart, or
            their logarithms ``(..., J, 3)``, compared as vectors.
        trust: Confidences ``(..., T + 2 (R + S), J, 1)``.
        groups: See :data:`Groups`.
        patch_radius: R, half-width of a patch [frames].
        search_radius: S, largest lag [frames].
        causal: Patches end at their frame, and neighbours lie in the past.
        embedding: Function of patches to features, see :func:`nonlocal_pose_means`.

    Raises:
        ValueError: If ``groups`` does not have a number for every joint, or the embedding gives
            something else than features ``(..., N, F)``.
    """

    def __init__(
        self,
        padded: Tensor,
        trust: Tensor,
        *,
        groups: Groups,
        patch_radius: int,
        search_radius: int,
        causal: bool,
        embedding: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        self._padded, self._trust = padded, trust
        self._members = _members(groups, padded.shape[-2])
        self._start = patch_radius + search_radius
        self._search = search_radius
        self._width = patch_radius + 1 if causal else 2 * patch_radius + 1
        self._patches = padded.shape[-3] - 2 * patch_radius  # T + 2 S
        self._frames = self._patches - 2 * search_radius
        self._learned = None if embedding is None else self._features(embedding, patch_radius)
        self._sides = (-1,) if causal else (-1, 1)
        self.lags = range(1, search_radius + 1)

    def neighbours(self, lag: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """The frames ``lag`` earlier and, unless causal, ``lag`` later.

        Yields:
            Distances of patches [rad^2] and votes before the kernel, both ``(..., T, J, 1)`` (the
            former may have one joint for all), votes 0 where nothing can be compared; and the
            differences ``(..., T, J, 3)`` [rad] from every frame to its neighbour.
        """
        difference = self._difference(lag)
        distance, common = self._distance(lag, difference)
        for side in self._sides:
            patch = self._search if side > 0 else self._search - lag
            pair = self._start if side > 0 else self._start - lag
            near, shared = (
                self._spread(x.narrow(-2, patch, self._frames)) for x in (distance, common)
            )
            votes = self._trust.narrow(-3, self._start + side * lag, self._frames)
            yield (
                near,
                torch.where(shared > 0, votes, 0.0),
                side * difference.narrow(-3, pair, self._frames),
            )

    def _difference(self, lag: int) -> Tensor:
        """From every frame to the one ``lag`` later, ``(..., N - lag, J, 3)`` [rad]."""
        first, second = self._padded[..., :-lag, :, :], self._padded[..., lag:, :, :]
        return second - first if first.shape[-1] == 3 else so3.log(so3.relative(first, second))

    def _distance(self, lag: int, difference: Tensor) -> tuple[Tensor, Tensor]:
        """Distances of patches and how much they have in common, ``(..., T + 2 S - lag, G)``."""
        trust = (self._trust[..., :-lag, :, :] * self._trust[..., lag:, :, :])[..., 0]
        square = difference.square().sum(-1) * trust
        total, common = (
            box_sum(self._grouped(x), self._width).narrow(-2, 0, self._patches - lag)
            for x in (square, trust)
        )
        distance = total / torch.where(common > 0, 3.0 * common, 1.0)
        if self._learned is not None:
            apart = self._learned[..., lag:, :] - self._learned[..., :-lag, :]
            distance = distance + apart.square().mean(-1, keepdim=True)
        return distance, common

    def _grouped(self, x: Tensor) -> Tensor:
        """Sum over the joints of every group: ``(..., N, J)`` to ``(..., N, G)``."""
        if self._members is None:
            return x
        return torch.stack([x[..., joints].sum(-1) for joints in self._members], -1)

    def _spread(self, x: Tensor) -> Tensor:
        """Give every joint the value of its group: ``(..., N, G)`` to ``(..., N, J or 1, 1)``."""
        if self._members is None or len(self._members) == 1:
            return x[..., None]
        group = {joint: g for g, joints in enumerate(self._members) for joint in joints}
        return x[..., [group[joint] for joint in sorted(group)]][..., None]

    def _features(self, embedding: Callable[[Tensor], Tensor], patch_radius: int) -> Tensor:
        """Features of the patches of all frames, ``(..., T + 2 S, F)``."""
        places = range(self._width)
        patch = torch.stack([self._padded.narrow(-3, p, self._patches) for p in places], -3)
        present = torch.stack([self._trust.narrow(-3, p, self._patches) for p in places], -3) > 0
        if patch.shape[-1] == 4:
            centre = self._padded.narrow(-3, patch_radius, self._patches)[..., None, :, :]
            patch = so3.log(so3.relative(centre, patch))
            # relative to a missing frame, nothing is known
            present = present & (present[..., patch_radius : patch_radius + 1, :, :])
        features = embedding(torch.where(present, patch, 0.0))
        if features.shape[:-1] != patch.shape[:-3]:
            raise ValueError(
                f"embedding must give features {(*patch.shape[:-3], 'F')}, "
                f"got {tuple(features.shape)}."
            )
        return features


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


def _members(groups: Groups, joints: int) -> list[list[int]] | None:
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
