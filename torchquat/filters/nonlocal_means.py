"""Dean's non-local pose means: patch attention along time."""

from collections.abc import Callable, Sequence
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from torchquat import so3, timeline
from torchquat._blocks import block_times
from torchquat._checks import check_choice, check_count, check_positive
from torchquat.filters._bandwidth import Bandwidth, per_joint, register_bandwidth, shown
from torchquat.filters._patches import Groups, PatchDistances, check_groups
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
    if confidence is None:
        confidence = unit.new_ones(unit.shape[:-1])
    bandwidth = per_joint("sigma", sigma, unit)
    bandwidth = bandwidth[..., None] if isinstance(bandwidth, Tensor) else bandwidth
    reach = patch_radius + search_radius
    padded, trust = timeline.pad(unit, confidence, reach, boundary)
    assert trust is not None
    filtered: list[Tensor] = []
    # an embedding may look at all of its patches together, as a normalisation does
    times = [(0, unit.shape[-3])] if embedding is not None else block_times(unit, reach)
    for start, frames in times:
        around = padded.narrow(-3, start, frames + 2 * reach)
        near = trust.narrow(-2, start, frames + 2 * reach)[..., None]
        patches = PatchDistances(
            around if chart == "local" else so3.log(around),
            near,
            groups=groups,
            patch_radius=patch_radius,
            search_radius=search_radius,
            causal=causal,
            embedding=embedding,
        )
        centre = unit.narrow(-3, start, frames)
        step = _attend(patches, confidence.narrow(-2, start, frames)[..., None], bandwidth)
        if chart == "global":
            filtered.append(so3.exp(so3.log(centre) + step))
        else:
            filtered.append(so3.compose(centre, so3.exp(step)))
    return timeline.restore(torch.cat(filtered, -3), unit, q)


def _attend(patches: PatchDistances, confidence: Tensor, sigma: float | Tensor) -> Tensor:
    """Weighted mean of the differences to all neighbours, ``(..., T, J, 3)`` [rad].

    In one pass over the lags: weights are taken relative to the largest one so far, and what is
    already added up is scaled down where a larger one comes. Where even the largest underflows, the
    mean is still right.
    """
    lowest = torch.finfo(confidence.dtype).min
    best = torch.full_like(confidence, lowest)  # the centre's exponent: the largest of the others
    total = torch.zeros_like(confidence)
    weighted = confidence.new_zeros(*confidence.shape[:-1], 3)
    for lag in patches.lags:
        for distance, votes, difference in patches.neighbours(lag):
            exponent = -0.5 * distance / sigma**2
            larger = torch.maximum(best, torch.where(votes > 0, exponent, lowest))
            top = larger.detach()  # a common factor: the mean does not depend on it
            shrink = torch.exp(best.detach() - top)
            m = votes * torch.exp(torch.where(votes > 0, exponent - top, 0.0))
            total, weighted = shrink * total + m, shrink * weighted + m * difference
            best = larger
    total = total + confidence * torch.exp(best - best.detach())
    empty = total <= 0
    return torch.where(empty, 0.0, weighted / torch.where(empty, 1.0, total))


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
