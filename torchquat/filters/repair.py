"""Repair of what is not noise but wrong: wild samples, and frames that are missing."""

from functools import reduce

import torch
from torch import Tensor, nn

from torchquat import missing, so3, timeline
from torchquat._eager import visible
from torchquat.filters._kriging import REACH, aligned, around, predict
from torchquat.filters._outliers import find_outliers
from torchquat.filters._pops import undone
from torchquat.filters._rows import places, quaternions_of, rows_of, shifted, unrowed

__all__ = ["OutlierRepair", "mended", "repair"]


def repair(
    q: Tensor, weight: Tensor | None = None, *, sigma: float | Tensor | None = None
) -> tuple[Tensor, Tensor]:
    r"""Find the samples of a joint that its other frames contradict, and replace or move them.

    First, stretches of up to 24 frames are looked for that begin and end with opposite jumps,
    larger than 0.3 rad and than the motion around explains. They are moved back: within they keep
    their shape. The first or last stretch may reach beyond the sequence, if no more than 15 frames
    lie within.

    Then every frame is predicted from those within four frames to each side, without itself,

    .. math::
        p_t \propto \sum_{0 < |k| \le 4} w_k(g)\, q_{t+k}, \quad
        e_t = d(p_t, q_t)

    with the weights of the best linear prediction, which depend on the pattern :math:`g` of good
    neighbours and on how much noise the joint has. An error :math:`e_t` is compared with the mean
    of those of the good frames around it, scaled by the variance to be expected of that pattern.
    The largest errors are flagged first and left out of what predicts the others; then all are
    judged again, flagged ones too. Where a joint has outliers beyond doubt, lesser ones are
    believed as well; where it has hardly any, a burst of motion is taken for what it is. What is
    flagged is replaced.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        sigma: Noise of every joint, if it is known, as in :func:`torchquat.noise.gaussian` [rad],
            >= 0; one value or one per joint. Errors of that size are never flagged.

    Returns:
        Unit quaternions ``(..., T, J, 4)``, those good only normalised, others replaced or moved;
        and confidences ``(..., T, J)``: those given, 0 where a sample was replaced. Both in the
        dtype of ``q``. What is flagged, and how far a stretch is moved, is given to derivatives.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or device does not fit, or ``sigma`` is out of range.

    Reference:
        Prediction: Matheron, "Principles of Geostatistics", Economic Geology 1963 (kriging).
    """
    prepared, confidence = timeline.prepare(q, weight)
    if sigma is not None:
        sigma = torch.as_tensor(sigma, dtype=prepared.dtype, device=prepared.device)
        if sigma.dim() and sigma.shape[-1] not in (1, q.shape[-2]):
            joints = q.shape[-2]
            raise ValueError(
                f"sigma must be one value or one for each of {joints} joints, "
                f"got {tuple(sigma.shape)}."
            )
        if visible(sigma) and not bool((sigma.isfinite() & (sigma >= 0)).all()):
            raise ValueError(f"sigma must be finite and >= 0, got {sigma.tolist()}.")
    result, trust = mended(prepared, confidence, sigma)
    return timeline.restore(result, prepared, q), trust.to(q.dtype)


class OutlierRepair(nn.Module):
    """Module form of :func:`repair`, for unknown noise and without the confidences."""

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Repair unit quaternions ``(..., T, J, 4)``."""
        return repair(q, weight)[0]


def mended(q: Tensor, weight: Tensor | None, sigma: Tensor | None) -> tuple[Tensor, Tensor]:
    """:func:`repair` of a prepared signal, without checks; ``sigma`` as ``(..., 1, J)``."""
    weight = torch.ones_like(q[..., 0]) if weight is None else weight
    if q.numel() == 0:
        return q, weight
    noise = torch.zeros_like(q[..., :1, :, 0]) + (0.0 if sigma is None else sigma)
    # first what lasts: the ends of a stretch would be taken for wild samples
    q = undone(q, weight > 0, noise)
    with torch.no_grad():
        found = find_outliers(q.detach(), weight > 0, sigma)
    return _filled(q, found.good, found.level), torch.where(found.good, weight, 0.0)


def _filled(q: Tensor, good: Tensor, level: Tensor) -> Tensor:
    """What is good, and in place of the rest what its neighbours predict."""
    rows, known, levels = quaternions_of(q), rows_of(good), rows_of(level)
    wrong = places(~known.all(-1))
    if wrong is None:
        return unrowed(_predicted(rows, known, levels), q)
    if wrong.numel() == 0:
        return q
    some = _predicted(*(x.index_select(-2, wrong) for x in (rows, known, levels)))
    return unrowed(rows.index_copy(1, wrong, some), q)


def _predicted(q: Tensor, good: Tensor, level: Tensor) -> Tensor:
    """:func:`_filled` for rows ``(4, N, T)``."""
    near = shifted(good, REACH)
    before, after = reduce(torch.logical_or, near[:REACH]), reduce(torch.logical_or, near[-REACH:])
    # further off, a cubic through few frames swings out more than the geodesic errs
    reached = (before & after) | near[REACH - 1] | near[REACH + 1]
    smooth = predict(around(aligned(torch.where(good, q, q.detach()), good), good), level).q
    smooth = so3.normalize(smooth.movedim(0, -1)).movedim(-1, 0)
    between = missing.interpolate(q.mT.movedim(0, -1), good.mT).movedim(-1, 0).mT
    return torch.where(good, q, torch.where(reached, smooth, between))
