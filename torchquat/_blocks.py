"""Work cut into blocks that fit a cache."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from torchquat import _planes
from torchquat._eager import derivatives, recorded, visible
from torchquat._planes import Quaternion
from torchquat._pull_back import gradients

__all__ = ["Window", "blocks", "in_windows"]

BLOCK = 2**17
"""Elements of one component in a block: a few dozen such planes fit a third-level cache."""


class Window(NamedTuple):
    """What a block reads: its own frames and ``reach`` more on either side.

    Attributes:
        q: Components of unit quaternions ``(4, ..., frames + 2 reach, J)``.
        trust: Weights of these frames; ``None``: 1.
        items: Batch items of the block.
        start: Its first frame.
        frames: How many it has.
        shared: What all blocks read.
    """

    q: Tensor
    trust: Tensor | None
    items: slice
    start: int
    frames: int
    shared: tuple[Any, ...]


Make = Callable[[Window], Quaternion]
"""From the window around a block to the components of the block."""


def in_windows(
    make: Make,
    padded: Tensor,
    trust: Tensor | None,
    reach: int,
    shared: Iterable[object] = (),
    *,
    multiple: int = 1,
) -> Tensor:
    """Make a sequence block by block from a padded one.

    Where there are several blocks, the backward pass makes each again: what is kept for it does not
    grow with what a block computes.

    Args:
        make: From the window around a block to the components of the block.
        padded: Unit quaternions ``(..., T + 2 reach, J, 4)``.
        trust: Weights ``(..., T + 2 reach, J)``; ``None``: 1.
        reach: Frames on either side of a block that it reads.
        shared: What else ``make`` reads; tensors among it get their gradients.
        multiple: The frames of every block but the last are a multiple of this.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.
    """
    batch, frames = padded.shape[:-3], padded.shape[-3] - 2 * reach
    padded = padded.reshape(math.prod(batch), *padded.shape[-3:])
    trust = None if trust is None else trust.reshape(padded.shape[:-1])
    plan = _Plan(make, reach, multiple, tuple(shared))
    tensors = [x for x in plan.shared if isinstance(x, Tensor)]
    known = [x for x in (padded, trust, *tensors) if x is not None]
    count = sum(len(times) for _, times in blocks(padded[:, :frames], reach, multiple))
    if count > 1 and recorded(*known):
        result = cast(Tensor, _Recomputed.apply(plan, padded, trust, *tensors))
    else:
        result = _assemble(plan, padded, trust)
    return result.reshape(*batch, *result.shape[1:])


class _Plan(NamedTuple):
    """How blocks are made and cut, and what all of them read."""

    make: Make
    reach: int
    multiple: int
    shared: tuple[object, ...]

    def reading(self, tensors: Iterable[Tensor]) -> "_Plan":
        """The same with other tensors in their places."""
        others = iter(tensors)
        shared = (next(others) if isinstance(x, Tensor) else x for x in self.shared)
        return self._replace(shared=tuple(shared))


def _assemble(plan: _Plan, padded: Tensor, trust: Tensor | None) -> Tensor:
    """Make ``(N, T, J, 4)`` block by block."""
    make, reach, multiple, _ = plan
    like = padded[:, : padded.shape[1] - 2 * reach]
    made: list[Tensor] = []
    result = None
    for items, times in blocks(like, reach, multiple):
        row: list[Tensor] = []
        for start, frames in times:
            planes = make(_window(plan, padded, trust, items, start, frames))
            if derivatives(*planes):
                row.append(_planes.join(planes))
                continue
            if result is None:
                result = like.new_empty(like.shape)
            for component, plane in enumerate(planes):  # with nothing between it and its place
                result[items, start : start + frames, :, component] = plane
        made += [_joined(row, 1)] if row else []
    if result is not None:
        return result
    return _joined(made, 0).contiguous() if made else like


def _joined(parts: list[Tensor], dim: int) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim)


def _window(
    plan: _Plan, padded: Tensor, trust: Tensor | None, items: slice, start: int, frames: int
) -> Window:
    span = slice(start, start + frames + 2 * plan.reach)
    q = _planes.stacked(padded[items, span])
    own = None if trust is None else trust[items, span]
    return Window(q, own, items, start, frames, plan.shared)


class _Recomputed(torch.autograd.Function):
    """All blocks, made again one by one in the backward pass."""

    @staticmethod
    def forward(
        ctx: Any, plan: _Plan, padded: Tensor, trust: Tensor | None, *shared: Tensor
    ) -> Tensor:
        ctx.plan = plan
        ctx.save_for_backward(padded, trust, *shared)
        return _assemble(plan, padded, trust)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        (slope,) = grad_outputs
        padded, trust, *shared = ctx.saved_tensors
        if torch.is_grad_enabled():  # a derivative of this one will be asked for
            # under names of their own: one may depend on another, which is not for here to follow
            padded, *shared = (x.view_as(x) for x in (padded, *shared))
            trust = None if trust is None else trust.view_as(trust)
            result = _assemble(ctx.plan.reading(shared), padded, trust)
            found = gradients([result], [slope], [padded, trust, *shared], create_graph=True)
            return None, *found
        return None, *_block_gradients(ctx.plan, padded, trust, shared, slope)


def _block_gradients(
    plan: _Plan,
    padded: Tensor,
    trust: Tensor | None,
    shared: Sequence[Tensor],
    slope: Tensor,
) -> list[Tensor | None]:
    """Gradients of the padded sequence, of its weights and of what all blocks share."""
    make, reach, multiple, _ = plan
    shared = [x.detach().requires_grad_(x.requires_grad) for x in shared]
    plan = plan.reading(shared)
    signal = torch.zeros_like(_planes.stacked(padded.detach()))
    trusted = None if trust is None else torch.zeros_like(trust)
    common: list[Tensor | None] = [None for _ in shared]
    for items, times in blocks(slope, reach, multiple):
        for start, frames in times:
            window = _window(plan, padded.detach(), trust, items, start, frames)
            q = window.q.detach().requires_grad_(padded.requires_grad)
            known = None
            if trust is not None and window.trust is not None:
                known = window.trust.detach().requires_grad_(trust.requires_grad)
            with torch.enable_grad():
                planes = make(window._replace(q=q, trust=known))
            slopes = _planes.split(slope[items, start : start + frames])
            by_q, by_trust, *own = gradients(planes, slopes, [q, known, *shared])
            span = slice(start, start + frames + 2 * reach)
            if by_q is not None:
                signal[:, items, span] += by_q
            if by_trust is not None and trusted is not None:
                trusted[items, span] += by_trust
            common = [
                old if new is None else new if old is None else old + new
                for old, new in zip(common, own, strict=True)
            ]
    return [signal.movedim(0, -1), trusted, *common]


def blocks(
    q: Tensor, reach: int, multiple: int = 1
) -> Iterator[tuple[slice, list[tuple[int, int]]]]:
    """Cut ``(N, T, J, 4)`` into blocks of the batch and of time.

    Args:
        q: The signal.
        reach: Frames on either side that a block of time reads besides its own.
        multiple: The frames of every block but the last are a multiple of this.

    Yields:
        Batch items, and the first frame and number of frames of each block of time; one block
        where cutting would not help.
    """
    items, frames, joints = q.shape[:3]
    if not visible(q):
        yield slice(None), [(0, frames)]
        return
    # reading the frames around a short block costs more than what the cache gains
    length = max(BLOCK // joints, 8 * reach, 1)
    length = min(frames, -(-length // multiple) * multiple)
    together = max(BLOCK // (length * joints), 1)
    times = [(start, min(length, frames - start)) for start in range(0, frames, length)]
    for item in range(0, items, together):
        yield slice(item, item + together), times
