"""Learned blocks: prediction and update of a lifting scheme, features of patches.

All three are the same small network, whose channels are rotation vectors: it mixes frames and
channels, never the three axes, so that a turn of all vectors goes through it. Joints share it.
"""

import math

import torch
from torch import Tensor, nn

from torchquat import so3, timeline
from torchquat._checks import check_count
from torchquat.filters._prediction import LinearPredict, LinearUpdate

__all__ = ["LearnedPredict", "LearnedUpdate", "PatchEmbedding"]

LARGE = 0.3  # [rad] where the network starts to saturate, before training
ALMOST_NOTHING = 1e-3  # share of a new embedding in the distance, before squaring


class LearnedPredict(nn.Module):
    r"""Linear prediction of the odd frames, and a learned step from there.

    .. math:: \mathrm{predict}(e)_i = \mathrm{linear}(e)_i \exp(f(w_{i-r}, \dots, w_{i+r})), \quad
        w_i = \log(e_i^{-1} e_{i+1})

    with a network f that convolves over time; beyond both ends the increment at the edge goes on.
    A new module predicts exactly as :class:`LinearPredict` does. About a fixed axis the network
    holds :class:`SquadPredict`, :math:`(w_{i-1} - w_{i+1}) / 16`, and can adapt to more.

    It commutes with a constant rotation from the left, the choice of the world frame, exactly (to
    rounding): increments do not see it. A constant rotation from the right, the choice of the body
    frame, turns the increments, and the learned step with them: that commutes too.

    Args:
        channels: Width of the network, >= 1.
        radius: Increments on each side that it sees [coarse frames], >= 0.

    Reference:
        Deng et al., "Vector Neurons: A General Framework for SO(3)-Equivariant Networks", ICCV
        2021, for networks whose channels are vectors.
    """

    def __init__(self, channels: int = 8, radius: int = 2) -> None:
        super().__init__()
        check_count("channels", channels, 1)
        check_count("radius", radius, 0)
        self.radius = radius
        self.linear = LinearPredict()
        self.network = _VectorNetwork(2 * radius + 1, channels, 1)

    def forward(self, even: Tensor) -> Tensor:
        """From even frames ``(..., N, J, 4)`` to the odd frames that follow them."""
        padded, _ = timeline.pad(even, None, self.radius + 1, "extrapolate")
        increment = so3.between(padded[..., :-1, :, :], padded[..., 1:, :, :])
        step = self.network(increment)[..., 1:, :, :, 0]  # the first is that of the frame before
        return so3.turn(self.linear(even), step)


class LearnedUpdate(nn.Module):
    r"""Linear update of the even frames, and a learned step more.

    .. math:: \mathrm{update}(d)_i = (d_{i-1} + d_i) / 4 + g(d_{i-1-r}, \dots, d_{i+r})

    with a network g that convolves over time; beyond both ends details are 0. A new module updates
    exactly as :class:`LinearUpdate` does. Details do not see the world frame, and a constant
    rotation of the body frame turns them, and this step, along.

    Args:
        channels: Width of the network, >= 1.
        radius: Details that it sees beside the two next to a frame, on each side, >= 0.
    """

    def __init__(self, channels: int = 8, radius: int = 1) -> None:
        super().__init__()
        check_count("channels", channels, 1)
        check_count("radius", radius, 0)
        self.radius = radius
        self.linear = LinearUpdate()
        self.network = _VectorNetwork(2 * radius + 2, channels, 1)

    def forward(self, detail: Tensor) -> Tensor:
        """From details ``(..., N, J, 3)`` to steps of the even frames [rad]."""
        zero = torch.zeros_like(detail.sum(-3, keepdim=True))  # also where there is no frame
        before, after = [zero] * (self.radius + 2), [zero] * self.radius
        padded = torch.cat([*before, detail, *after], -3)
        step = self.network(padded)[..., 1:, :, :, 0]  # the first is that of the frame before
        return self.linear(detail) + step


class PatchEmbedding(nn.Module):
    """Learned features of patches, for ``NonLocalPoseMeans(embedding=...)``.

    A small network along the frames of a patch, the same for every joint. Distances between
    features do not depend on the world frame nor, where all joints turn alike, on the body frame.

    A new module adds next to nothing, a millionth of the features' own distances, so that training
    starts at the plain distance. It cannot add exactly nothing: the distance is a square, with no
    gradient at 0. For the same reason gradients are small at first, so train it with an optimiser
    that scales them, as Adam does, and give it ``learnable=True`` for the bandwidth: features can
    only tell patches apart, not make them more alike.

    Args:
        patch_radius: That of the filter [frames], >= 0.
        features: Vectors per joint, >= 1.
        channels: Width of the network, >= 1.
        joints: Learn how much each of so many joints counts, >= 1; ``None``: all the same, which
            fits any skeleton.
        causal: Whether the filter is.
    """

    gain: Tensor | None

    def __init__(
        self,
        patch_radius: int = 5,
        *,
        features: int = 4,
        channels: int = 8,
        joints: int | None = None,
        causal: bool = False,
    ) -> None:
        super().__init__()
        check_count("patch_radius", patch_radius, 0)
        check_count("features", features, 1)
        check_count("channels", channels, 1)
        if joints is not None:
            check_count("joints", joints, 1)
        self.gain = None if joints is None else nn.Parameter(torch.ones(joints, 1, 1))
        self.width = patch_radius + 1 if causal else 2 * patch_radius + 1
        self.network = _VectorNetwork(self.width, channels, features)
        with torch.no_grad():
            self.network.mix.normal_(std=ALMOST_NOTHING / math.sqrt(channels))

    def forward(self, patch: Tensor) -> Tensor:
        """From patches ``(..., N, P, J, 3)`` [rad] to features ``(..., N, F)``."""
        if patch.shape[-3] != self.width:
            raise ValueError(
                f"patch must have {self.width} frames, as patch_radius and causal say, "
                f"got {patch.shape[-3]}."
            )
        if self.gain is not None and patch.shape[-2] != len(self.gain):
            raise ValueError(f"patch must have {len(self.gain)} joints, got {patch.shape[-2]}.")
        found = self.network(patch)  # (..., N, 1, J, 3, features)
        if self.gain is not None:
            found = found * self.gain.to(found.dtype)
        return found.flatten(-4)


class _VectorNetwork(nn.Module):
    """A convolution over time and a mixture of its channels, all of which are vectors.

    In between, vectors saturate at a learned length: outliers weigh less. New, its output is 0.

    Args:
        width: Frames that it sees at a time.
        channels: Vectors in between.
        outputs: Vectors for every frame.
    """

    def __init__(self, width: int, channels: int, outputs: int) -> None:
        super().__init__()
        self.kernel = nn.Parameter(torch.randn(width, channels) / math.sqrt(width))
        self.log_large = nn.Parameter(torch.full((channels,), math.log(LARGE)))
        self.mix = nn.Parameter(torch.zeros(channels, outputs))

    def forward(self, v: Tensor) -> Tensor:
        """From vectors ``(..., N, J, 3)`` to ``(..., N - width + 1, J, 3, outputs)``."""
        width, count = len(self.kernel), v.shape[-3] - len(self.kernel) + 1
        kernel, mix, large = (x.to(v.dtype) for x in (self.kernel, self.mix, self.log_large.exp()))
        # no matrix product: autocast would round it, and the batch's size would show in it
        hidden = v.narrow(-3, 0, count)[..., None] * kernel[0]  # (..., J, 3, channels)
        for lag in range(1, width):
            hidden = hidden + v.narrow(-3, lag, count)[..., None] * kernel[lag]
        share = (hidden / large).square().sum(-2, keepdim=True)
        hidden = hidden * torch.rsqrt(1.0 + share)
        return (hidden[..., None] * mix).sum(-2)
