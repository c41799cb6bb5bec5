"""Non-local pose means for one frame: all patches of a window against its own."""

import torch
from torch import Tensor

from torchquat._online import rotations
from torchquat._online.windows import Centre
from torchquat.filters._patches import Patches

__all__ = ["nonlocal_means"]


def nonlocal_means(patches: Patches, sigma: float | Tensor, chart: str, like: Tensor) -> Centre:
    """The mean of alike poses, as :func:`torchquat.nonlocal_pose_means` has it."""
    radius, search = patches.patch_radius, patches.search_radius
    count = search + 1 if patches.causal else 2 * search + 1
    rate = -0.5 / sigma**2
    lowest = torch.finfo(like.dtype).min
    others = like.new_ones((count, 1))
    others[search] = 0.0

    def centre(q: Tensor, trust: Tensor | None) -> Tensor:
        around = q if chart == "local" else _logs(q)
        distance, common = _distances(around, trust, patches)
        votes = others
        if trust is not None and common is not None:
            votes = others * torch.where(common > 0, trust.narrow(-2, radius, count), 0.0)
        exponent = torch.where(votes > 0, distance * rate, lowest)
        best = exponent.amax(-2, keepdim=True)
        m = votes * torch.exp(exponent - best)  # the frame itself has the largest weight, 1
        own = 1.0 if trust is None else trust[:, radius + search]
        total = m.sum(-2) + own
        divisor = torch.where(total > 0, total, 1.0)
        seen = around.narrow(-2, radius, count)
        here = seen[..., search : search + 1, :]
        if chart == "global":
            mean = ((m * seen).sum(-2) + own * here[..., 0, :]) / divisor
            return rotations.exp(torch.where(total > 0, mean, here[..., 0, :]))
        apart = rotations.nearer(seen, here) - here
        _, factor = rotations.angle_and_factor(rotations.squared_norm(apart))
        tangent = rotations.tangent_part(here[..., 0, :], (m * factor * apart).sum(-2) / divisor)
        angle = rotations.squared_norm(tangent).sqrt_()
        return rotations.turn_along(here[..., 0, :], tangent, angle)

    return centre


def _distances(
    around: Tensor, trust: Tensor | None, patches: Patches
) -> tuple[Tensor, Tensor | None]:
    """Distances ``(P, N, J or 1)`` of N patches from the own one, and what both have in common."""
    far = around.unfold(-2, patches.width, 1)  # (C, P, N, J, width)
    near = far.narrow(2, patches.search_radius, 1)
    square = rotations.squared_norm(far - near)
    if len(around) == 4:
        square = rotations.quarter_angle(square).square_().mul_(16.0)
    if trust is None:
        total = patches.grouped(square.sum(-1))
        return patches.spread(total / (3.0 * patches.width * patches.sizes(total))), None
    known = trust.unfold(-2, patches.width, 1)
    both = known * known.narrow(1, patches.search_radius, 1)
    total, common = patches.grouped((square * both).sum(-1)), patches.grouped(both.sum(-1))
    distance = total / torch.where(common > 0, 3.0 * common, 1.0)
    return patches.spread(distance), patches.spread(common)


def _logs(q: Tensor) -> Tensor:
    """Rotation vectors ``(3, ...)`` at the identity."""
    identity = torch.zeros_like(q)
    identity[3] = 1.0
    return rotations.between(identity, rotations.nearer(q, identity))
