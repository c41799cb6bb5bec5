"""Dean's non-local pose means: patch attention along time."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from torchquat import _operations, _planes, so3, timeline
from torchquat._blocks import Window, in_windows
from torchquat._checks import check_choice, check_count, check_positive
from torchquat._operations import accumulated
from torchquat._planes import Quaternion
from torchquat.filters._bandwidth import Bandwidth, per_joint, register_bandwidth, shown
from torchquat.filters._lee_shin import divided
from torchquat.filters._patches import (
    Groups,
    Neighbour,
    Patches,
    check_groups,
    features,
    members,
)
from torchquat.timeline import BOUNDARIES, Boundary

__all__ = ["Chart", "NonLocalPoseMeans", "nonlocal_pose_means"]

Chart = Literal["local", "global"]
CHARTS: tuple[str, ...] = get_args(Chart)


def nonlocal_pose_means(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    sigma: Bandwidth = 0.008,
    patch_radius: int = 5,
    search_radius: int = 10,
    groups: Groups = "pose",
    chart: Chart = "local",
    boundary: Boundary = "replicate",
    causal: bool = False,
    embedding: Callable[[Tensor], Tensor] | None = None,
) -> Tensor:
    r"""Move every pose to the weighted mean of those whose surroundings in time look alike.

    .. math::
        \hat q_i = q_i \exp\Big(\frac{\sum_j m_{ij} \log(q_i^{-1} q_j)}{\sum_j m_{ij}}\Big), \quad
        m_{ij} = \exp\Big(-\frac{d(P_i, P_j)}{2\sigma^2}\Big), \quad
        m_{ii} = \max_{j \ne i} m_{ij}

    with :math:`P_i` the patch of frames around frame i and :math:`d` the mean of the squared
    differences over frames, joints of a group, and axes.

    Confidences scale votes, and what a frame counts for in the distances of patches. A missing
    frame does neither: distances average over what is present in both patches.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        sigma: How unlike patches may be, root of the mean squared difference per axis [rad], > 0;
            one value or one per joint.
        patch_radius: Half-width of a compared patch [frames], >= 0.
        search_radius: How far patches are sought [frames], >= 0; 0 changes nothing.
        groups: Which joints are compared together and share weights: ``"pose"`` all, ``"joint"``
            each alone, or the number of its group for every joint.
        chart: Where differences and means are taken: ``"local"`` in the tangent space of the frame
            that is denoised, independent of the coordinate frame; ``"global"`` on ``log q`` at the
            identity, as printed, which tears rotations near half turns apart.
        boundary: Rule at both ends of the sequence.
        causal: Compare and average frames of the past only: patches ``i - patch_radius .. i``,
            sought among ``i - search_radius .. i``.
        embedding: Learned part of the distance: a function of patches ``(..., N, P, J, 3)`` of
            rotation vectors [rad] (relative to the frame of the patch in the local chart, ``log q``
            in the global one; 0 where missing) to features ``(..., N, F)``. The mean squared
            difference of features is added to :math:`d`.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T J), whatever the windows; with an
        embedding also the patches, O(T P J).

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range, group, chart or boundary name is invalid.

    Reference:
        Dean, "Non-local Pose Means for Denoising Motion Capture Data", eq. 3. Departs from print in
        taking the mean instead of the sum in d: summed, the published sigma of 0.008 underflows on
        any skeleton. His "Dirichlet" boundary is ``replicate``, his "Neumann" ``extrapolate``.
    """
    check_positive("sigma", sigma)
    check_count("patch_radius", patch_radius, 0)
    check_count("search_radius", search_radius, 0)
    check_choice("chart", chart, CHARTS)
    check_groups(groups)
    boundary = timeline.past_boundary(boundary, causal)
    unit, confidence = timeline.prepare(q, weight, causal=causal)
    bandwidth = per_joint("sigma", sigma, unit)
    patches = Patches(members(groups, unit.shape[-2]), patch_radius, search_radius, causal)
    padded, trust = timeline.pad(unit, confidence, patches.reach, boundary)
    learned = None
    if embedding is not None:
        known = padded.new_ones(padded.shape[:-1]) if trust is None else trust
        charted = padded if chart == "local" else so3.log(padded)
        learned = features(embedding, charted, known, patches)
        learned = learned.reshape(math.prod(unit.shape[:-3]), *learned.shape[-2:])

    def moved(window: Window) -> Quaternion:
        bandwidth, learned = window.shared
        planes = _planes.components(window.q)
        centre = _planes.cut(planes, patches.reach, window.frames)
        near = None
        if learned is not None:
            span = window.frames + 2 * search_radius
            near = learned[window.items].narrow(-2, window.start, span)
        if chart == "local":
            around = _planes.components(_planes.align_path(window.q))
        else:
            around = _planes.log(_planes.upper(planes))
        seen = patches.neighbours(around, window.trust, near)
        own = tuple(x.narrow(-2, patches.reach, window.frames) for x in around)
        mean, total = _attend(seen, own, _middle(window, patches.reach), bandwidth)
        if chart == "local":
            return _operations.turned(centre, _planes.vector_part(own, mean))
        x, y, z = (torch.where(total > 0, a, b) for a, b in zip(mean, own, strict=True))
        return _planes.exp((x, y, z))

    result = in_windows(moved, padded, trust, patches.reach, (bandwidth, learned))
    # in the local chart every frame has kept its hemisphere already
    return result.to(q.dtype) if chart == "local" else timeline.restore(result, unit, q)


def _middle(window: Window, reach: int) -> Tensor | None:
    """Confidences of the frames of a block themselves."""
    return None if window.trust is None else window.trust.narrow(-2, reach, window.frames)


def _attend(
    neighbours: Iterable[Neighbour],
    own: tuple[Tensor, ...],
    confidence: Tensor | None,
    sigma: float | Tensor,
) -> tuple[tuple[Tensor, ...], Tensor]:
    """Weighted mean of the components of a frame and all its neighbours, ``(..., T, J)`` each.

    Together with the sum of the weights: where that is 0, so is the mean.

    Each neighbour counts times its factor, so that the vector part of the quotient by the frame
    itself is the mean of the rotation vectors to all neighbours. Weights are taken relative to the
    largest, which is the centre's: where even that one underflows, the mean is still right.
    """
    lowest = torch.finfo(own[0].dtype).min
    seen = [
        (_where(each.votes, each.distance * (-0.5 / sigma**2), lowest), each) for each in neighbours
    ]
    best = own[0].new_full((), lowest)
    for exponent, _ in seen:
        best = torch.maximum(best, exponent)

    top = best.detach()  # a common factor: the mean does not depend on it
    total = torch.exp(best - top)
    total = total if confidence is None else total * confidence
    weighted = tuple((total * component).expand_as(component) for component in own)
    for exponent, (_, votes, factor, place) in seen:
        m = torch.exp(_where(votes, exponent - top, 0.0))
        m = m if votes is None else votes * m
        total = total + m
        pull = m.expand_as(place[0]).contiguous() if factor is None else m * factor
        weighted = accumulated(weighted, pull, place)
    return divided(weighted, total), total


def _where(votes: Tensor | None, x: Tensor, other: float) -> Tensor:
    """``x`` where something votes."""
    return x if votes is None else torch.where(votes > 0, x, other)


class NonLocalPoseMeans(nn.Module):
    """Module form of :func:`nonlocal_pose_means`; arguments as there.

    The bandwidth is stored as a logarithm: an optimiser step keeps it positive. An ``embedding``
    that is a module is trained along with it.
    """

    log_sigma: Tensor

    def __init__(
        self,
        sigma: float | Sequence[float] = 0.008,
        *,
        patch_radius: int = 5,
        search_radius: int = 10,
        groups: Groups = "pose",
        chart: Chart = "local",
        boundary: Boundary = "replicate",
        causal: bool = False,
        embedding: nn.Module | None = None,
        learnable: bool = False,
    ) -> None:
        super().__init__()
        check_count("patch_radius", patch_radius, 0)
        check_count("search_radius", search_radius, 0)
        check_groups(groups)
        check_choice("chart", chart, CHARTS)
        check_choice("boundary", boundary, BOUNDARIES)
        register_bandwidth(self, "sigma", sigma, learnable)
        self.patch_radius = patch_radius
        self.search_radius = search_radius
        self.groups: Groups = groups
        self.chart: Chart = chart
        self.boundary: Boundary = boundary
        self.causal = causal
        self.embedding = embedding

    @property
    def sigma(self) -> Tensor:
        """Bandwidth of patch distances [rad], ``()`` or ``(J,)``."""
        return self.log_sigma.exp()

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return nonlocal_pose_means(
            q,
            weight,
            sigma=self.sigma,
            patch_radius=self.patch_radius,
            search_radius=self.search_radius,
            groups=self.groups,
            chart=self.chart,
            boundary=self.boundary,
            causal=self.causal,
            embedding=self.embedding,
        )

    def extra_repr(self) -> str:
        """Bandwidth, windows and options."""
        return (
            f"sigma={shown(self.sigma)}, patch_radius={self.patch_radius}, "
            f"search_radius={self.search_radius}, groups={self.groups!r}, chart={self.chart!r}, "
            f"boundary={self.boundary!r}, causal={self.causal}"
        )
