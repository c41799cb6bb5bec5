"""Haar's scheme in one go: split, shrunk and put together again, block by block.

The same arithmetic as :class:`~torchquat.filters.lifting.LiftingStep` with Haar's predict and
update. Frames are put once in the order of the bits of their number, lowest first: then the even
and the odd frames of every level are the two halves of what lies in memory, and nothing is copied
between levels. Blocks of ``2^L`` frames do not know of each other.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torchquat import _operations, _planes
from torchquat._blocks import Window, in_windows
from torchquat._eager import derivatives, highest
from torchquat._planes import Quaternion
from torchquat._series import invisible
from torchquat.filters._thresholds import Shrinkage, kept

__all__ = ["haar_denoised"]

Coarser = Callable[[Tensor], Tensor]
"""What becomes of the coarse frames of a level."""

Step = Callable[[Tensor, Tensor, Tensor, Shrinkage, Coarser], Tensor]
"""One level: from even and odd frames to both, put together, after shrinkage."""


def haar_denoised(q: Tensor, thresholds: Sequence[Tensor], shrinkage: Shrinkage) -> Tensor:
    """Shrink the details of every level by thresholds that are known beforehand.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``, T >= 1.
        thresholds: One per level, finest first, broadcastable to ``(..., 1, J, 1)`` [rad].
        shrinkage: How.

    Returns:
        Unit quaternions ``(..., T, J, 4)``, each in the hemisphere of its input.
    """
    batch, joints = q.shape[:-3], q.shape[-2]
    flat = [t.expand(*batch, 1, joints, 1).reshape(-1, 1, joints) for t in thresholds]

    def made(window: Window) -> Quaternion:
        own = [t[window.items] for t in window.shared]
        step = _recorded if derivatives(window.q, *own) else _plain
        shrunk = _shrunk(_ordered(window.q, len(flat)), window.frames, own, shrinkage, step)
        return _planes.components(_planes.aligned(_in_time(shrunk, window.frames), window.q))

    return in_windows(made, q, None, 0, shared=flat, multiple=2 ** len(flat))


def _shrunk(
    q: Tensor, frames: int, thresholds: Sequence[Tensor], shrinkage: Shrinkage, step: Step
) -> Tensor:
    """Components ``(4, 2, ..., 2, N, B, J)``, of which only so many frames are there."""
    if not thresholds:
        return q
    even, odd = q[:, 0], q[:, 1]
    if frames % 2:
        odd = _completed(odd, even, frames)

    def coarser(coarse: Tensor) -> Tensor:
        return _shrunk(coarse, (frames + 1) // 2, thresholds[1:], shrinkage, step)

    return step(even, odd, thresholds[0], shrinkage, coarser)


def _recorded(
    even: Tensor, odd: Tensor, threshold: Tensor, shrinkage: Shrinkage, coarser: Coarser
) -> Tensor:
    """One level, of operations that know their derivatives."""
    odd = _planes.aligned(odd, even)
    detail = _operations.between(_planes.components(even), _planes.components(odd))
    middle = _operations.normalized(_planes.components(even + odd))
    share = 0.5 * kept(_planes.dot(detail, detail), threshold, shrinkage)
    x, y, z = (share * component for component in detail)
    coarse = _planes.components(coarser(torch.stack(middle)))
    later, earlier = _operations.turned_both_ways(coarse, (x, y, z))
    return torch.stack([torch.stack(earlier), torch.stack(later)], 1)


def _plain(
    even: Tensor, odd: Tensor, threshold: Tensor, shrinkage: Shrinkage, coarser: Coarser
) -> Tensor:
    """One level in fewest steps.

    Half the sum and half the difference of two unit quaternions are at right angles and span the
    geodesic between them: the angle from the middle to either is all that shrinks.
    """
    difference = odd - even
    square = _planes.dot(difference.unbind(0), difference.unbind(0))
    if not highest(square) <= 2.0:  # some lie in opposite hemispheres
        odd = _planes.sign_of(2.0 - square) * odd
        difference = odd - even
        square = _planes.dot(difference.unbind(0), difference.unbind(0))
    middle = (even + odd).mul_((4.0 - square).rsqrt_())
    axis = _planes.vector_part(middle.unbind(0), difference.unbind(0))
    square += invisible(square)
    quarter = (0.25 * square).sqrt_().asin_()  # of the rotation angle between both
    if shrinkage == "soft":
        quarter = quarter.sub_(0.25 * threshold).clamp_(min=0.0)
    else:
        quarter *= kept(16.0 * quarter.square(), threshold, shrinkage)
    coarse = coarser(middle)
    turn = torch.stack(_planes.by_vector(coarse.unbind(0), axis))
    turn *= square.rsqrt_().mul_(quarter.sin())
    along = coarse * quarter.cos_()
    result = along.new_empty((4, 2, *along.shape[1:]))
    torch.sub(along, turn, out=result[:, 0])
    torch.add(along, turn, out=result[:, 1])
    return result


def _completed(odd: Tensor, even: Tensor, frames: int) -> Tensor:
    """Put the last even frame, which is alone, in the place of its missing partner."""
    blocks, bits = odd.shape[-2], odd.dim() - 4
    alone = torch.zeros(2**bits, dtype=torch.bool, device=odd.device)
    alone[_reversed((frames // 2) % 2**bits, bits)] = True
    end = torch.where(alone.reshape(*[2] * bits, 1, 1, 1), _last(even), _last(odd))
    return torch.cat([odd.narrow(-2, 0, blocks - 1), end], -2)


def _reversed(number: int, bits: int) -> int:
    """A number whose bits are read from the other end."""
    return int(f"{number:0{bits}b}"[::-1], 2) if bits else 0


def _ordered(q: Tensor, levels: int) -> Tensor:
    """From ``(4, N, T, J)`` to ``(4, 2, ..., 2, N, B, J)`` with the lowest bit of the frame first.

    Frames are added at the end to make it a multiple of ``2^L``.
    """
    missing = -q.shape[-2] % 2**levels
    if missing:
        q = torch.cat([q, _last(q).expand(*q.shape[:2], missing, -1)], -2)
    order = [0, *range(levels + 2, 2, -1), 1, 2, levels + 3]
    return q.reshape(4, q.shape[1], -1, *[2] * levels, q.shape[-1]).permute(order).contiguous()


def _in_time(q: Tensor, frames: int) -> Tensor:
    """Undo :func:`_ordered`."""
    levels = q.dim() - 4
    order = [0, levels + 1, levels + 2, *range(levels, 0, -1), levels + 3]
    whole = q.permute(order).reshape(4, q.shape[-3], -1, q.shape[-1])
    return whole.narrow(-2, 0, frames)


def _last(q: Tensor) -> Tensor:
    return q.narrow(-2, q.shape[-2] - 1, 1)
