"""Batches of sequences of different lengths, padded to one."""

import torch
from torch import Tensor, nn

from torchquat._checks import check_signal

__all__ = ["Ragged"]


class Ragged(nn.Module):
    """A filter for padded batches: every sequence is filtered as if it stood alone.

    A weight of 0 behind the end would do less: the padding would still count as frames, and what a
    filter does at a boundary would not be done at the end. Sequences of one length are filtered
    together.

    Args:
        filter: Any module with ``forward(q, weight=None)`` on unit quaternions ``(..., T, J, 4)``.
    """

    def __init__(self, filter: nn.Module) -> None:
        super().__init__()
        self.filter = filter

    def forward(self, q: Tensor, lengths: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions.

        Args:
            q: Unit quaternions ``(..., T, J, 4)``, padded with anything.
            lengths: Frames of each sequence, whole numbers ``(...)`` in [0, T].
            weight: Confidence ``(..., T, J)``, or broadcastable to it, >= 0; 0 marks a missing
                frame.

        Returns:
            Unit quaternions ``(..., T, J, 4)``; the padding comes back as it was, bit for bit.

        Raises:
            TypeError: If an argument is not a tensor of a fitting dtype.
            ValueError: If a shape does not fit, or a length is out of its range.
        """
        check_signal(q, weight)
        _check_lengths(lengths, q)
        batch, frames = q.shape[:-3], q.shape[-3]
        rows = q.reshape(batch.numel(), *q.shape[-3:])
        trusts = None if weight is None else weight.expand(q.shape[:-1]).reshape(rows.shape[:-1])
        result = rows
        for length in torch.unique(lengths).tolist():
            index = (lengths.reshape(-1) == length).nonzero()[:, 0].to(q.device)
            some = rows.index_select(0, index)
            trust = None if trusts is None else trusts.index_select(0, index)[:, :length]
            head = self.filter(some[:, :length], trust)
            result = result.index_copy(0, index, torch.cat([head, some[:, length:frames]], 1))
        return result.reshape(*batch, *q.shape[-3:])


def _check_lengths(lengths: Tensor, q: Tensor) -> None:
    if not isinstance(lengths, Tensor) or lengths.is_floating_point() or lengths.is_complex():
        kind = lengths.dtype if isinstance(lengths, Tensor) else type(lengths).__name__
        raise TypeError(f"lengths must be a tensor of whole numbers, got {kind}.")
    if lengths.dtype == torch.bool:
        raise TypeError("lengths must be a tensor of whole numbers, got torch.bool.")
    if lengths.shape != q.shape[:-3]:
        raise ValueError(
            f"lengths must have shape {tuple(q.shape[:-3])}, one a sequence of q "
            f"{tuple(q.shape)}, got {tuple(lengths.shape)}."
        )
    wrong = lengths[(lengths < 0) | (lengths > q.shape[-3])]
    if wrong.numel() > 0:
        raise ValueError(f"lengths must lie in [0, {q.shape[-3]}], got {int(wrong[0])}.")
