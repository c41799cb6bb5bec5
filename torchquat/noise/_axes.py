"""Axes about which a joint moves least: there, noise is seen best."""

from collections.abc import Iterator

import torch
from torch import Tensor

__all__ = ["AXES", "least_axes", "moment"]

AXES = 3
LEAST = {3: 0.0, 2: -1.0368, 1: -2.0727}
"""Mean of the least n eigenvalues of a symmetric 3 x 3 matrix of Gaussian numbers, their variance 2
on the diagonal and 1 elsewhere: the covariance of N vectors is such a matrix over the root of N."""
SPREAD = {3: 0.8165, 2: 0.8945, 1: 1.0957}
"""Standard deviation of the same."""
NO_AXIS = 1e-6  # share of the power: a hinge does not turn about such an axis at all
LEAST_EXPECTED = 0.3  # below it, of few vectors, the correction is too uncertain


def least_axes(
    vector: Tensor, chosen: Tensor, independent: Tensor
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Compare the power about the quietest axes with the mean over all three.

    Axes are those of the joint's own covariance. The least of three estimates lies below the truth
    by chance: the ratios are corrected for that, so that noise alone gives 1 on average.

    Args:
        vector: Vectors ``(3, ..., J, N)``.
        chosen: Which of them count, booleans ``(..., J, N)``.
        independent: How many independent ones they are worth, ``(..., J)``, > 0.

    Yields:
        For three, two and one axis: the ratio ``(..., J)``; the relative standard error that the
        root of a power has if it is found by these axes; and whether it can be told.
    """
    power = _principal_power(vector, chosen)
    total = power.sum(-1, keepdim=True)
    mean = total[..., 0] / AXES
    first = (power <= NO_AXIS * total).sum(-1, keepdim=True)
    root = independent.sqrt()
    for axes in (3, 2, 1):
        place = (first + torch.arange(axes, device=vector.device)).clamp(max=AXES - 1)
        least = power.gather(-1, place).mean(-1) if axes < AXES else mean
        expected = 1.0 + LEAST[axes] / root
        ratio = least / torch.where(mean > 0, mean, 1.0) / expected.clamp(min=LEAST_EXPECTED)
        known = (mean > 0) & (expected > LEAST_EXPECTED)
        yield ratio, 0.5 * SPREAD[axes] / root, known


def _principal_power(vector: Tensor, chosen: Tensor) -> Tensor:
    """Eigenvalues of the sum of ``v v^T``, rising, ``(..., J, 3)``."""
    return torch.linalg.eigvalsh(moment(vector, chosen)).clamp(min=0.0).to(vector.dtype)


def moment(vector: Tensor, chosen: Tensor) -> Tensor:
    """The sum of ``v v^T`` of those chosen, in double precision ``(..., J, 3, 3)``."""
    kept = chosen.to(vector.dtype) * vector
    entries = {
        (i, j): (kept[i] * kept[j]).sum(-1).double() for i in range(AXES) for j in range(i, AXES)
    }
    rows = [
        torch.stack([entries[min(i, j), max(i, j)] for j in range(AXES)], -1) for i in range(AXES)
    ]
    return torch.stack(rows, -1)
