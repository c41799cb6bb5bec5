"""The blocks of the lifting schemes: predictions of odd frames, updates of even ones."""

import torch
from torch import Tensor, nn

from torchquat import so3, timeline

__all__ = [
    "BezierPredict",
    "HaarPredict",
    "HaarUpdate",
    "LinearPredict",
    "LinearUpdate",
    "SquadPredict",
]


class HaarPredict(nn.Module):
    """Predict that nothing changes: every odd frame equals the even frame before it."""

    def forward(self, even: Tensor) -> Tensor:
        """From even frames ``(..., N, J, 4)`` to the odd frames that follow them."""
        return even


class LinearPredict(nn.Module):
    """Predict the middle of the geodesic between the two even frames around every odd one.

    After the last even frame, the increment at the edge continues.
    """

    def forward(self, even: Tensor) -> Tensor:
        """From even frames ``(..., N, J, 4)`` to the odd frames that follow them."""
        return so3.midpoint(even, _shifted(even, 1))


class SquadPredict(nn.Module):
    r"""Predict by spherical cubic interpolation, ``squad(q_i, q_{i+1}, s_i, s_{i+1}, 1/2)``.

    .. math:: s_i = q_i \exp\Big(-\frac{\log(q_i^{-1} q_{i+1}) + \log(q_i^{-1} q_{i-1})}{4}\Big)

    About a fixed axis this is the four-point scheme, exact for cubic motion. Beyond both ends the
    increment at the edge continues.
    """

    def forward(self, even: Tensor) -> Tensor:
        """From even frames ``(..., N, J, 4)`` to the odd frames that follow them."""
        following, control, control_following = _control_points(even)
        middle = so3.midpoint(even, following)
        return so3.midpoint(middle, so3.midpoint(control, control_following))


class BezierPredict(nn.Module):
    """Predict by the Shoemake-Bezier curve as the paper prints it, with the ``s_i`` of squad.

    De Casteljau's construction at 1/2 with control points ``q_i, s_i, s_{i+1}, q_{i+1}``. About a
    fixed axis the outer weights are -3/32, those of squad -2/32: it overshoots motion of constant
    acceleration, which squad predicts exactly.
    """

    def forward(self, even: Tensor) -> Tensor:
        """From even frames ``(..., N, J, 4)`` to the odd frames that follow them."""
        following, control, control_following = _control_points(even)
        first = so3.midpoint(even, control)
        second = so3.midpoint(control, control_following)
        third = so3.midpoint(control_following, following)
        return so3.midpoint(so3.midpoint(first, second), so3.midpoint(second, third))


class HaarUpdate(nn.Module):
    """Move every even frame half of the way to its odd one: the coarse frame is their mean.

    This is the geodesic mean of both, exactly. Over more than one level it is a mean of means:
    the mean of all frames exactly about a fixed axis, else to first order.
    """

    def forward(self, detail: Tensor) -> Tensor:
        """From details ``(..., N, J, 3)`` to steps of the even frames [rad]."""
        return 0.5 * detail


class LinearUpdate(nn.Module):
    """Move every even frame by a quarter of the details around it.

    Coarse frames then keep the running mean: about a fixed axis exactly, away from the ends, else
    to first order. Beyond both ends details are 0, as the prediction continues the motion there.
    """

    def forward(self, detail: Tensor) -> Tensor:
        """From details ``(..., N, J, 3)`` to steps of the even frames [rad]."""
        before = torch.cat([torch.zeros_like(detail[..., :1, :, :]), detail], -3)
        return 0.25 * (before[..., : detail.shape[-3], :, :] + detail)


def _shifted(even: Tensor, offset: int) -> Tensor:
    """The frame ``offset`` later in place of every frame; beyond the ends the edge turns on."""
    padded, _ = timeline.pad(even, None, abs(offset), "extrapolate")
    return padded.narrow(-3, abs(offset) + offset, even.shape[-3])


def _control_points(even: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For every frame: the next frame, its own control point ``s_i`` and the next one's."""
    padded, _ = timeline.pad(even, None, 2, "extrapolate")
    frames = even.shape[-3]
    middle = padded.narrow(-3, 1, frames + 2)
    ahead = so3.between(middle, padded.narrow(-3, 2, frames + 2))
    behind = so3.between(middle, padded.narrow(-3, 0, frames + 2))
    control = so3.turn(middle, -0.25 * (ahead + behind))
    return padded.narrow(-3, 3, frames), control[..., 1:-1, :, :], control[..., 2:, :, :]
