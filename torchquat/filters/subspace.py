"""Poses kept near what a few components can express: linear ones, or those of a kernel."""

import torch
from torch import Tensor, nn

from torchquat import timeline
from torchquat._checks import check_count, check_positive
from torchquat.filters._chart import Chart, refitted
from torchquat.filters._spectra import leading, of_eigenvalues

__all__ = [
    "KernelPCAFilter",
    "PrincipalComponentFilter",
    "kernel_pca_filter",
    "principal_component_filter",
]


def principal_component_filter(
    q: Tensor, weight: Tensor | None = None, *, components: float
) -> Tensor:
    r"""Project every pose on the principal components of the sequence.

    .. math::
        \hat x_t = \bar x + V V^T (x_t - \bar x), \quad
        x_t = \big(\log(\mu_1^{-1} q_{t1}), \ldots, \log(\mu_J^{-1} q_{tJ})\big)

    with :math:`\mu_j` the mean rotation of joint j and the columns of V the leading eigenvectors of
    the covariance of x. Order in time does not matter: what is removed is whatever joints do not
    do together. Joints share components, on purpose.

    Confidences weigh joints in mean and covariance. A missing one does not count there; it takes
    part in the projection of its pose as interpolated along time.

    Gradients are exact, those of the components included, and finite where eigenvalues coincide;
    second derivatives leave out how the components turn.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        components: How many, as an integer >= 1; ``3 J`` and more change nothing. Or how much of
            the variance they must hold, in (0, 1).

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T J + J^2).

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.

    Reference:
        Pearson 1901; on rotations, the linearised principal geodesic analysis of Fletcher et al.,
        IEEE Transactions on Medical Imaging 2004.
    """
    _check_components(components)
    unit, confidence = timeline.prepare(q, weight)
    result = refitted(unit, confidence, lambda chart: _on_components(chart, components))
    return timeline.restore(result, unit, q)


def kernel_pca_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    components: float,
    sigma: float | None = None,
    landmarks: int = 256,
    iterations: int = 10,
) -> Tensor:
    r"""Project every pose on the leading components of a kernel, and find the pose that fits.

    .. math::
        k(x, y) = \exp\Big(-\frac{|x - y|^2}{2 \cdot 3J \sigma^2}\Big), \quad
        \hat x \leftarrow \frac{\sum_i \gamma_i k(\hat x, x_i)\, x_i}
                               {\sum_i \gamma_i k(\hat x, x_i)}

    with x as in :func:`principal_component_filter`, and :math:`\sum_i \gamma_i \phi(x_i)` the
    projection of the pose's feature: its pre-image is sought by iteration from the pose itself. A
    step whose denominator nearly vanishes is not made.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame. A pose counts for the
            components as much as its joints on average.
        components: How many, as an integer >= 1, or how much of the kernel's variance they must
            hold, in (0, 1).
        sigma: Width of the kernel, root mean square difference per axis [rad], > 0; ``None``: that
            between any two poses of the sequence.
        landmarks: How many poses, evenly spaced in time, span the components, >= 1.
        iterations: Steps towards the pre-image, >= 0; 0 changes nothing.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T (J + landmarks)). Derivatives take
        a width that was measured as given; second ones leave out how the components turn.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or range is invalid.

    Reference:
        Mika, Schölkopf, Smola, Müller, Scholz and Rätsch, "Kernel PCA and De-Noising in Feature
        Spaces", NIPS 1998, eq. 10.
    """
    _check_kernel(components, sigma, landmarks, iterations)
    unit, confidence = timeline.prepare(q, weight)

    def fit(chart: Chart) -> Tensor:
        width = _squared_width(chart, sigma)
        anchors, gamma = _in_kernel_space(chart, width, components, landmarks)
        points = chart.points
        for _ in range(iterations):
            points = _towards_pre_image(points, anchors, gamma, width)
        return points

    return timeline.restore(refitted(unit, confidence, fit), unit, q)


class PrincipalComponentFilter(nn.Module):
    """Module form of :func:`principal_component_filter`; arguments as there."""

    def __init__(self, components: float) -> None:
        super().__init__()
        _check_components(components)
        self.components = components

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return principal_component_filter(q, weight, components=self.components)

    def extra_repr(self) -> str:
        """How much is kept."""
        return f"components={self.components}"


class KernelPCAFilter(nn.Module):
    """Module form of :func:`kernel_pca_filter`; arguments as there."""

    def __init__(
        self,
        components: float,
        *,
        sigma: float | None = None,
        landmarks: int = 256,
        iterations: int = 10,
    ) -> None:
        super().__init__()
        _check_kernel(components, sigma, landmarks, iterations)
        self.components = components
        self.sigma = sigma
        self.landmarks = landmarks
        self.iterations = iterations

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return kernel_pca_filter(
            q,
            weight,
            components=self.components,
            sigma=self.sigma,
            landmarks=self.landmarks,
            iterations=self.iterations,
        )

    def extra_repr(self) -> str:
        """How much is kept, and the kernel."""
        return (
            f"components={self.components}, sigma={self.sigma}, landmarks={self.landmarks}, "
            f"iterations={self.iterations}"
        )


_NARROWEST = 1e-30
"""Squared widths below this are those of a motion at rest."""


def _check_components(components: float) -> None:
    if isinstance(components, float):
        if not 0.0 < components < 1.0:
            raise ValueError(
                f"components must be an integer >= 1 or a share in (0, 1), got {components}."
            )
        return
    check_count("components", components, 1)


def _check_kernel(components: float, sigma: float | None, landmarks: int, iterations: int) -> None:
    _check_components(components)
    if sigma is not None:
        check_positive("sigma", sigma)
    check_count("landmarks", landmarks, 1)
    check_count("iterations", iterations, 0)


def _mean(chart: Chart) -> Tensor:
    """Weighted mean pose ``(N, 1, 3 J)``; near 0, but not 0 where a mean has not converged."""
    total = chart.trust.sum(1, keepdim=True)
    return (chart.trust * chart.points).sum(1, keepdim=True) / torch.where(total > 0, total, 1.0)


def _on_components(chart: Chart, components: float) -> Tensor:
    """Points projected on the leading directions of their covariance."""
    centre = _mean(chart)
    offset = chart.points - centre
    weighed = chart.trust.sqrt() * offset
    covariance = weighed.mT @ weighed
    eigenvalues, basis = torch.linalg.eigh(covariance.detach())
    kept = leading(eigenvalues, components)
    return centre + offset @ of_eigenvalues(covariance, (eigenvalues, basis), kept)


def _squared_width(chart: Chart, sigma: float | None) -> Tensor:
    """Squared width of the kernel in the space of poses, ``(N, 1, 1)`` or ``()``."""
    axes = chart.points.shape[-1]
    if sigma is not None:
        return torch.tensor(axes * sigma**2, dtype=chart.points.dtype, device=chart.points.device)
    # a choice of the method, as the number of components is: no gradient runs through it
    square = (chart.trust * (chart.points - _mean(chart)).square()).detach().sum((-2, -1))
    total = chart.trust.detach().sum((-2, -1))
    width = 2.0 * axes * square / torch.where(total > 0, total, 1.0)
    return torch.where(width > _NARROWEST, width, 1.0)[:, None, None]


def _in_kernel_space(
    chart: Chart, width: Tensor, components: float, landmarks: int
) -> tuple[Tensor, Tensor]:
    """Anchors ``(N, M, 3 J)`` and what each counts for in a pose's projection ``(N, T, M)``."""
    place = _evenly(chart.points.shape[1], landmarks, chart.points.device)
    anchors = chart.points.index_select(1, place)
    # a frame that a compiled program takes several times counts once
    fresh = place != torch.cat([torch.full_like(place[:1], -1), place[:-1]])
    share = fresh * chart.trust.index_select(1, place).mean(-1)
    total = share.sum(-1, keepdim=True)
    share = share / torch.where(total > 0, total, 1.0)
    return anchors, _projected(chart.points, anchors, share, width, components)


def _evenly(frames: int, wanted: int, device: torch.device) -> Tensor:
    """Frames in the middle of ``wanted`` equal stretches; all, where there are fewer."""
    if not torch.compiler.is_compiling():  # a compiled program takes short sequences several times
        wanted = min(frames, wanted)
    return (2 * torch.arange(wanted, device=device) + 1) * frames // (2 * wanted)


def _kernel(x: Tensor, y: Tensor, width: Tensor) -> Tensor:
    """Values of the kernel ``(N, T, M)`` for points ``(N, T, 3 J)`` and ``(N, M, 3 J)``.

    Distances through products lose digits of small ones only, where the kernel is 1 anyway.
    """
    square = x.square().sum(-1, keepdim=True) + y.square().sum(-1)[:, None] - 2.0 * (x @ y.mT)
    return torch.exp(square.clamp(min=0) * (-0.5 / width))


def _projected(
    points: Tensor, anchors: Tensor, share: Tensor, width: Tensor, components: float
) -> Tensor:
    """What every anchor counts for in the projections of points, ``(N, T, M)``; rows sum to 1."""
    inner, outer = _kernel(anchors, anchors, width), _kernel(points, anchors, width)
    average = (share[:, None] * inner).sum(-1)  # of the kernel's values at every anchor
    whole = (share * average).sum(-1)[:, None, None]
    inner = inner - average[:, None] - average[..., None] + whole
    outer = outer - average[:, None] - (share[:, None] * outer).sum(-1, keepdim=True) + whole

    # the root has no slope at 0
    root = torch.where(share > 0, torch.where(share > 0, share, 1.0).sqrt(), 0.0)
    scaled = root[..., None] * inner * root[:, None]
    known, basis = torch.linalg.eigh(scaled.detach())
    # below this an eigenvalue is rounding, and one over it noise
    present = known > 1e-10 * known.amax(-1, keepdim=True).clamp(min=1e-10)
    values = leading(known, components) * present / torch.where(present, known, 1.0)
    inverse = of_eigenvalues(scaled, (known, basis), values, -values.square())
    own = (outer * root[:, None]) @ inverse * root[:, None]
    return own + share[:, None] * (1.0 - own.sum(-1, keepdim=True))


def _towards_pre_image(points: Tensor, anchors: Tensor, gamma: Tensor, width: Tensor) -> Tensor:
    """One step of the iteration, made where its denominator is safely positive."""
    pull = gamma * _kernel(points, anchors, width)
    total = pull.sum(-1, keepdim=True)
    safe = total > 0.05 * pull.detach().abs().sum(-1, keepdim=True)
    return torch.where(safe, pull @ anchors / torch.where(safe, total, 1.0), points)
