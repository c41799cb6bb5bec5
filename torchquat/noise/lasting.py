"""Errors that last: what one frame suffers, the next ones do too."""

import torch
from torch import Tensor

from torchquat._checks import check_count, check_layout
from torchquat.noise._draws import Sigma, apply, chances, check_share, turns, unit_of

__all__ = ["correlated", "dropout", "pops"]


def correlated(
    q: Tensor, sigma: Sigma, *, rho: float = 0.9, generator: torch.Generator | None = None
) -> Tensor:
    r"""Turn every rotation by a rotation vector that changes slowly: ``q_t exp(v_t)``.

    .. math:: v_t = \rho\, v_{t-1} + \sqrt{1 - \rho^2}\; n_t, \quad v_0 = n_0

    with :math:`n` as in :func:`gaussian`: every ``v`` has the same size, and neighbours the
    correlation :math:`\rho`. Errors of video estimators are of this kind.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        sigma: Standard deviation of each component of every ``v`` [rad], >= 0; one value or one
            per joint.
        rho: Correlation of neighbouring frames, in (-1, 1); 0 is :func:`gaussian`.
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor.
        ValueError: If ``q`` has another shape, or a value is out of its range.
    """
    if not -1.0 < rho < 1.0:
        raise ValueError(f"rho must be in (-1, 1), got {rho}.")
    unit = unit_of(q)
    v = turns(unit, sigma, generator)
    v = torch.cat([v[..., :1, :, :], v[..., 1:, :, :] * (1.0 - rho**2) ** 0.5], -3)
    reach = 1
    while reach < v.shape[-3]:  # v holds the last `reach` terms of the sum: twice as many, ...
        earlier = torch.zeros_like(v)
        earlier[..., reach:, :, :] = v[..., :-reach, :, :]
        v = v + rho**reach * earlier
        reach *= 2
    return apply(unit, v, q)


def pops(
    q: Tensor,
    sigma: Sigma,
    *,
    share: float = 0.05,
    length: tuple[int, int] = (5, 15),
    generator: torch.Generator | None = None,
) -> Tensor:
    """Let joints jump to another place and stay there for a while.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``.
        sigma: Size of the jumps, one rotation vector each, as in :func:`gaussian` [rad].
        share: Expected share of joint samples that are off, in [0, 1].
        length: Least and greatest length of a stretch [frames], >= 1, all equally likely.
            Stretches may start before the first frame, end after the last, and cut each other off.
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor, or a length not an integer.
        ValueError: If ``q`` has another shape, or a value is out of its range.
    """
    unit = unit_of(q)
    inside, start = _stretches(unit, share, length, generator)
    v = turns(unit, sigma, generator, frames=unit.shape[-3] + length[1] - 1)
    v = v.gather(-3, start[..., None].expand(*start.shape, 3))
    return apply(unit, inside.to(v.dtype)[..., None] * v, q)


def dropout(
    q: Tensor,
    *,
    share: float = 0.1,
    length: tuple[int, int] = (5, 15),
    whole_frames: bool = False,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Lose stretches of frames: NaN stands there, which every filter takes as missing.

    :func:`torchquat.validity` tells which are left. Use that as ``weight`` together with the whole
    motion where the values of lost frames are wanted.

    Args:
        q: Quaternions ``(..., T, J, 4)`` of any norm.
        share: Expected share of joint samples that are lost, in [0, 1].
        length: Least and greatest length of a stretch [frames], as in :func:`pops`.
        whole_frames: All joints are lost at once, as where nobody is detected.
        generator: Source of the draws, on the device of ``q``.

    Returns:
        Quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` is not a floating-point tensor, or a length not an integer.
        ValueError: If ``q`` has another shape, or a value is out of its range.
    """
    check_layout(q)
    lost, _ = _stretches(q[..., :1, :] if whole_frames else q, share, length, generator)
    return torch.where(lost[..., None], torch.nan, q)


def _stretches(
    q: Tensor, share: float, length: tuple[int, int], generator: torch.Generator | None
) -> tuple[Tensor, Tensor]:
    """Which samples ``(..., T, J)`` lie in a stretch, and the number of the latest one's draw.

    Draws begin so early that the first frame is as likely to be inside as any other.
    """
    shortest, longest = length
    check_share(share)
    check_count("length", shortest, 1)
    check_count("length", longest, shortest)
    early, frames = longest - 1, q.shape[-3]
    # a frame is outside if no stretch that is long enough has started: (1 - p)^(mean length)
    p = 1.0 - (1.0 - share) ** (2.0 / (shortest + longest))
    start = chances(q, generator, frames=frames + early) < p
    spread = chances(q, generator, frames=frames + early) * (longest - shortest + 1)
    frame = torch.arange(frames + early, device=q.device)[:, None]
    end = torch.where(start, frame + shortest + spread.long(), 0)
    inside = end.cummax(-2).values > frame
    latest = torch.where(start, frame, 0).cummax(-2).values
    return inside[..., early:, :], latest[..., early:, :]
