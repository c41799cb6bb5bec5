"""The moving mean that Blender smooths animation curves with, on rotations."""

import torch
from torch import Tensor, nn

from torchquat import timeline
from torchquat.filters._masks import as_mask, convolve

__all__ = ["MovingMeanFilter", "moving_mean_filter"]

KERNEL = (4.0 / 24.0, 6.0 / 24.0, 4.0 / 24.0, 6.0 / 24.0, 4.0 / 24.0)


def moving_mean_filter(q: Tensor, weight: Tensor | None = None) -> Tensor:
    r"""Average every frame with two on either side, by ``[4, 6, 4, 6, 4] / 24``.

    .. math::
        \hat q_i = q_i \exp\Big(\sum_{j=-2}^{2} m_j (c_{i+j} - c_i)\Big), \quad
        c_{i+1} = c_i + \log(q_i^{-1} q_{i+1})

    The first and last two frames stay as they are. Blender applies the mask to every animation
    curve by itself; here it acts on the increments of rotations.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or device does not fit.

    Reference:
        "Blender WMM" of Dean, "Non-local Pose Means", Table I; Lee and Shin, IEEE TVCG 2002.
    """
    unit, confidence = timeline.prepare(q, weight)
    mask = as_mask(KERNEL, unit)
    moved = convolve(unit, confidence, mask, boundary="replicate", causal=False)
    frame = torch.arange(unit.shape[-3], device=unit.device)[:, None, None]
    inside = (frame >= 2) & (frame < unit.shape[-3] - 2)
    return torch.where(inside, moved, unit).to(q.dtype)


class MovingMeanFilter(nn.Module):
    """Module form of :func:`moving_mean_filter`; it has no parameters."""

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return moving_mean_filter(q, weight)
