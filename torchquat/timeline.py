"""What every windowed filter shares: entry and exit, and what lies outside the sequence."""

from typing import Literal, get_args

import torch
from torch import Tensor

from torchquat import _planes, missing, so3
from torchquat._checks import check_choice, check_signal

__all__ = [
    "BOUNDARIES",
    "Boundary",
    "first_frames",
    "halves",
    "interleave",
    "pad",
    "past_boundary",
    "prepare",
    "restore",
]

Boundary = Literal["truncate", "replicate", "reflect", "extrapolate", "circular"]
"""What stands outside the sequence ``abcd`` in a window of radius 3:

================  =============  ==============================================
``truncate``      ``   abcd   ``  nothing: frames outside weigh 0
``replicate``     ``aaaabcdddd``  the edge frame holds
``reflect``       ``dcbabcdcba``  the sequence mirrored, edge frame not repeated
``extrapolate``   ``...abcd...``  the increment at the edge continues
``circular``      ``bcdabcdabc``  the sequence repeats
================  =============  ==============================================

All work for one frame and for windows longer than the sequence. A causal window must not read
ahead: it uses ``replicate`` where that is asked for, and ``truncate`` instead of any other rule.
"""

BOUNDARIES: tuple[str, ...] = get_args(Boundary)


def prepare(
    q: Tensor, weight: Tensor | None = None, *, causal: bool = False
) -> tuple[Tensor, Tensor | None]:
    """Check and normalise an input, and fill its missing frames.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm; not written to.
        weight: Confidence or mask, broadcastable to ``(..., T, J)``.
        causal: Fill without looking ahead.

    Returns:
        Unit quaternions ``(..., T, J, 4)`` in float32 or float64, each in the hemisphere of its
        input, and confidences ``(..., T, J)``, 0 where a frame is missing; ``None`` where all are
        seen to be 1.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape or device does not fit.
    """
    check_signal(q, weight)
    work = q.float() if q.dtype.itemsize < 4 else q
    if weight is None:
        unit = so3.normalized_if_ordinary(work)
        if unit is not None:
            return unit, None
    confidence = missing.confidence(work, weight)
    unit = so3.normalize(work)
    filled = missing.interpolate(unit, confidence > 0, causal=causal)
    # rows without a direction have no hemisphere: they follow the frame they are filled from
    reference = torch.where(so3.usable(work)[..., None], unit, 0.0)
    return so3.align(filled, reference), confidence


def restore(result: Tensor, prepared: Tensor, q: Tensor) -> Tensor:
    """Give a result the hemispheres of the prepared input and the dtype of the input.

    Args:
        result: Unit quaternions ``(..., T, J, 4)``.
        prepared: What :func:`prepare` made of ``q``.
        q: The input of the filter.

    Returns:
        Unit quaternions ``(..., T, J, 4)`` in the dtype of ``q``.
    """
    result = so3.align(result, prepared).to(q.dtype)
    return result if result.is_contiguous() else _planes.packed(result.unbind(-1))


def past_boundary(boundary: Boundary, causal: bool) -> Boundary:
    """The boundary rule that a window uses: a causal one must not read ahead."""
    check_choice("boundary", boundary, BOUNDARIES)
    return "truncate" if causal and boundary != "replicate" else boundary


def pad(
    q: Tensor, confidence: Tensor | None, radius: int, boundary: Boundary
) -> tuple[Tensor, Tensor | None]:
    """Put ``radius`` frames before and after a sequence, as the boundary rule has them.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        confidence: Weights ``(..., T, J)``; ``None``: 1.
        radius: Frames on each side, >= 0.
        boundary: Rule at both ends.

    Returns:
        Unit quaternions ``(..., T + 2 radius, J, 4)`` and weights ``(..., T + 2 radius, J)``, or
        ``None`` where all are 1; a frame outside weighs as much as the frame that it stands for.
    """
    frames = q.shape[-3]
    if frames == 0:  # nothing to stand for: weightless identities
        identity = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=q.dtype, device=q.device)
        shape = (*q.shape[:-3], 2 * radius, q.shape[-2])
        weightless = (q if confidence is None else confidence).new_zeros(shape)
        return identity.expand(*shape, 4), weightless
    wanted = torch.arange(-radius, frames + radius, device=q.device)
    index = _source(wanted, frames, boundary)
    # component by component, so that they still lie one after the other in memory
    planes = q.movedim(-1, 0)
    edges = [planes.index_select(-2, each) for each in (index[:radius], index[frames + radius :])]
    if boundary == "extrapolate" and radius > 0:
        edges = _continued(q, edges, wanted - index)
    padded = torch.cat([edges[0], planes, edges[1]], -2).movedim(0, -1)
    if confidence is not None:
        confidence = confidence.index_select(-2, index)
    if boundary == "truncate":
        inside = (wanted == index).to(q.dtype)[:, None]
        ones = q.new_ones(padded.shape[:-1]) if confidence is None else confidence
        confidence = inside * ones
    return padded, confidence


def _source(wanted: Tensor, frames: int, boundary: Boundary) -> Tensor:
    """The frame inside the sequence that stands at each wanted place."""
    if boundary == "circular":
        return _modulo(wanted, frames)
    if boundary == "reflect":
        period = max(2 * (frames - 1), 1)
        folded = _modulo(wanted, period)
        return torch.where(folded < frames, folded, period - folded)
    return wanted.clamp(0, frames - 1)


def _modulo(wanted: Tensor, period: int) -> Tensor:
    """Remainders >= 0; of a tensor, since ONNX takes no open length for a number here."""
    return wanted.remainder(torch.full((1,), period, device=wanted.device))


def _continued(q: Tensor, edges: list[Tensor], overshoot: Tensor) -> list[Tensor]:
    """Turn on, frame by frame, with the increment found at each edge; one frame stands still."""
    last, radius = q.shape[-3] - 1, edges[0].shape[-2]
    at_start = torch.arange(2, device=q.device).clamp(max=last)
    at_end = torch.arange(last - 1, last + 1, device=q.device).clamp(min=0)
    frames = overshoot.to(q.dtype)[:, None, None]
    turned = []
    for edge, pair, count in zip(
        edges, (at_start, at_end), (frames[:radius], frames[last + 1 + radius :]), strict=True
    ):
        step = so3.between(*q.index_select(-3, pair).split(1, -3))
        turned.append(so3.turn(edge.movedim(0, -1), count * step).movedim(-1, 0))
    return turned


def first_frames(x: Tensor, frames: int, dim: int = -3) -> Tensor:
    """The first frames of ``x``; an exported program's length stays open."""
    if not torch.compiler.is_compiling():
        return x.narrow(dim, 0, frames)
    return x.index_select(dim, torch.arange(frames, device=x.device))


def halves(q: Tensor) -> tuple[Tensor, Tensor]:
    """Even and odd frames ``(..., ceil(T / 2), J, 4)`` and ``(..., floor(T / 2), J, 4)``."""
    if torch.compiler.is_compiling():
        return q[..., ::2, :, :], q[..., 1::2, :, :]
    planes = q.movedim(-1, 0)
    even, odd = (planes[..., start::2, :].contiguous().movedim(0, -1) for start in (0, 1))
    return even, odd


def interleave(even: Tensor, odd: Tensor) -> Tensor:
    """Frames of both in turn, ``(..., N, J, 4)`` and as many or one fewer, even ones first."""
    evens, odds = even.shape[-3], odd.shape[-3]
    if torch.compiler.is_compiling():  # which must not ask how many there are
        frame = torch.arange(evens + odds, device=even.device)
        place = frame // 2 + evens * (frame % 2)
        return torch.cat([even, odd], -3).index_select(-3, place)
    # component by component, so that they still lie one after the other in memory
    e, o = even.movedim(-1, 0), odd.movedim(-1, 0)
    planes = torch.stack([e.narrow(-2, 0, odds), o], -2).flatten(-3, -2)
    if evens > odds:
        planes = torch.cat([planes, e.narrow(-2, odds, evens - odds)], -2)
    return planes.movedim(0, -1)
