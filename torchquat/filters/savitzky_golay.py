"""Savitzky and Golay's filter on rotations: a polynomial fitted to every window."""

from typing import Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor, nn

from torchquat import _operations, _planes, so3, timeline
from torchquat._checks import check_choice, check_count
from torchquat._planes import Vector
from torchquat.filters._lee_shin import divided
from torchquat.filters._masks import as_mask, convolve
from torchquat.timeline import Boundary

__all__ = ["SavitzkyGolayFilter", "savitzky_golay_filter"]

Ends = Boundary | Literal["interp"]
ENDS = ("interp", *get_args(Boundary))


def savitzky_golay_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    radius: int,
    order: int,
    boundary: Ends = "interp",
) -> Tensor:
    r"""Fit a polynomial to every window, and take its value in the middle.

    .. math::
        \hat q_i = q_i \exp\Big(\sum_{j=-k}^{k} m_j (c_{i+j} - c_i)\Big), \quad
        m_j = \big[V (V^T V)^{-1} V^T\big]_{0j}, \quad V_{jp} = j^p

    with :math:`c` the running sum of the increments :math:`\log(q_i^{-1} q_{i+1})`. Confidences
    act as in :func:`linear_filter`.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        radius: Half-width k of the window [frames], >= 0; 0 changes nothing.
        order: Degree of the polynomial, in [0, 2 radius]; 2 and 3 are the same filter.
        boundary: Rule at both ends of the sequence. ``"interp"``: the first and last ``radius``
            frames are those of the polynomial fitted to the first and last whole window, as scipy
            has it; a sequence shorter than the window is held on as far as needed.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range or boundary name is invalid.

    Reference:
        Savitzky and Golay, Analytical Chemistry 1964, on Lee and Shin's construction (IEEE TVCG
        2002); ends as ``scipy.signal.savgol_filter`` has them.
    """
    return _fitted(q, weight, _fit(radius, order), boundary)


class SavitzkyGolayFilter(nn.Module):
    """Module form of :func:`savitzky_golay_filter`; arguments as there."""

    def __init__(self, radius: int, order: int, *, boundary: Ends = "interp") -> None:
        super().__init__()
        check_choice("boundary", boundary, ENDS)
        self.radius = radius
        self.order = order
        self.boundary: Ends = boundary
        self._fit = _fit(radius, order)

    @property
    def mask(self) -> list[float]:
        """Coefficients ``m_{-k}, ..., m_k`` away from the ends."""
        return self._fit.mask

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return _fitted(q, weight, self._fit, self.boundary)

    def extra_repr(self) -> str:
        """Window, degree and boundary."""
        return f"radius={self.radius}, order={self.order}, boundary={self.boundary!r}"


class _Fit(NamedTuple):
    """A polynomial fitted to a window.

    Attributes:
        mask: What every frame of the window counts for in the middle, ``2 radius + 1`` numbers.
        basis: Orthonormal polynomials at the frames, ``(2 radius + 1, order + 1)``. What all frames
            count for at all places is its product with itself, which is large and made as needed.
    """

    mask: list[float]
    basis: list[list[float]]


def _fit(radius: int, order: int) -> _Fit:
    """Checked, and fitted to a window around 0."""
    check_count("radius", radius, 0)
    check_count("order", order, 0)
    if order > 2 * radius:
        raise ValueError(f"order must be <= 2 radius = {2 * radius}, got {order}.")
    places = np.arange(-radius, radius + 1) / max(radius, 1)
    basis, _ = np.linalg.qr(np.vander(places, order + 1))
    return _Fit((basis @ basis[radius]).tolist(), basis.tolist())


def _fitted(q: Tensor, weight: Tensor | None, fit: _Fit, boundary: Ends) -> Tensor:
    check_choice("boundary", boundary, ENDS)
    unit, confidence = timeline.prepare(q, weight)
    radius = len(fit.mask) // 2
    mask = as_mask(fit.mask, unit)
    inner: Boundary = "replicate" if boundary == "interp" else boundary
    result = convolve(unit, confidence, mask, boundary=inner, causal=False)
    if boundary == "interp" and radius > 0 and unit.shape[-3] > 0:
        result = _with_ends(result, unit, confidence, fit)
    return result.to(q.dtype)


def _with_ends(result: Tensor, unit: Tensor, confidence: Tensor | None, fit: _Fit) -> Tensor:
    """The result with frames of the outermost fits at both ends."""
    trust = unit.new_ones(unit.shape[:-1]) if confidence is None else confidence
    frames, radius = unit.shape[-3], len(fit.mask) // 2
    basis = torch.tensor(fit.basis, dtype=torch.float64, device=unit.device)
    fits = (basis[:radius] @ basis.mT).to(unit.dtype)
    since = torch.arange(frames, device=unit.device)
    step, count = torch.zeros_like(unit[..., :3]), 0.0
    for way in (since, since.flip(0)):  # from the start, and from the end
        moves = _first_moves(unit.index_select(-3, way), trust.index_select(-2, way), fits)
        near = (way < radius).to(unit.dtype)[:, None, None]
        step = step + near * moves.index_select(-3, way.clamp(max=radius - 1))
        count = count + near
    # a short sequence has frames that belong to both ends
    ends = so3.turn(unit, step / torch.where(count > 0, count, 1.0))
    return torch.where(count > 0, ends, result)


def _first_moves(unit: Tensor, trust: Tensor, fits: Tensor) -> Tensor:
    """Rotation vectors ``(..., radius, J, 3)`` [rad] from the first frames to their fits."""
    place = torch.arange(fits.shape[1], device=unit.device).clamp(max=unit.shape[-3] - 1)
    window, trust = unit.index_select(-3, place), trust.index_select(-2, place)
    path = _running_sum(window)
    gain, loss = (fits.clamp(**bound).sum(1)[:, None] for bound in ({"min": 0}, {"max": 0}))
    (up, some), (down, other) = (
        _mean(path, trust, part) for part in (fits.clamp(min=0), -fits.clamp(max=0))
    )
    # where one sign has no frame left, the other stands for both, as inside the sequence
    return _planes.join(
        [
            gain * torch.where(some > 0, u, d) + loss * torch.where(other > 0, d, u)
            for u, d in zip(up, down, strict=True)
        ]
    )


def _running_sum(window: Tensor) -> Vector:
    """The path ``c`` of a window, from its first frame on."""
    q = _planes.components(_planes.align_path(_planes.stacked(window)))
    width = window.shape[-3] - 1
    steps = _operations.between(_planes.cut(q, 0, width), _planes.cut(q, 1, width))
    start = torch.zeros_like(q[0].narrow(-2, 0, 1))
    x, y, z = (torch.cat([start, step], -2).cumsum(-2) for step in steps)
    return x, y, z


def _mean(path: Vector, trust: Tensor, m: Tensor) -> tuple[tuple[Tensor, ...], Tensor]:
    """Means of ``c_j - c_i`` for weights ``m`` ``(radius, width)``, and the sums of the weights."""
    radius, width = m.shape
    total = torch.zeros_like(trust.narrow(-2, 0, radius))
    weighted = tuple(torch.zeros_like(total) for _ in path)
    for j in range(width):
        share = m[:, j, None] * trust.narrow(-2, j, 1)
        total = total + share
        weighted = tuple(
            sum_ + share * (c.narrow(-2, j, 1) - c.narrow(-2, 0, radius))
            for sum_, c in zip(weighted, path, strict=True)
        )
    return divided(weighted, total), total
