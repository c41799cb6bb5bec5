"""Mixtures of estimates, by Stein's unbiased estimate of their risk."""

from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["Estimate", "mixed"]

SHARES = 256.0  # steps of a share between 0 and 1
SPREAD = 10.0  # one over the variance of shares among joints
BETWEEN = 0.6180339887498949  # where a share is rounded up: at no simple fraction, as 1/2 is


class Estimate(NamedTuple):
    """What a filter makes of data in noise of unit power.

    Attributes:
        value: Vectors ``(..., T, J, 3)``.
        freedom: How far each frame's value follows the noise of the data, ``(..., T, J)``: the
            covariance of the two, by Stein's lemma.
    """

    value: Tensor
    freedom: Tensor


def mixed(estimates: list[Estimate], data: Tensor, trust: Tensor) -> Tensor:
    r"""Go from each estimate to the next as far as the risk falls.

    With the residuals :math:`r = x - a` of the mixture so far, the next one a way :math:`d = b - a`
    off, and freedoms :math:`f`, Stein's estimate of the risk is least at the share

    .. math:: \hat\theta_j = \frac{A_j}{B_j}, \quad
        A_j = \sum_t r_{tj} \cdot d_{tj} - (f^b_{tj} - f^a_{tj}), \quad B_j = \sum_t |d_{tj}|^2,

    brought into [0, 1]. Chance moves it by :math:`1 / \sqrt{B_j}`, so it is drawn to the mean of
    all joints: :math:`\theta_j = (A_j + K \bar\theta) / (B_j + K)`, as if shares were spread by
    :math:`1 / \sqrt K`. They are rounded, since the last digits of sums depend on what else is in
    the batch. Derivatives take them as given.

    Args:
        estimates: At least one.
        data: Data ``(..., T, J, 3)`` that all estimates are of.
        trust: Share of its noise that is left in each frame's data, ``(..., T, J)``, in [0, 1]; 0
            for frames and joints that do not count.

    Returns:
        The mixture ``(..., T, J, 3)``.

    Reference:
        Stein, "Estimation of the Mean of a Multivariate Normal Distribution", Annals of Statistics
        1981.
    """
    value, freedom = estimates[0]
    for following in estimates[1:]:
        way, more = following.value - value, following.freedom - freedom
        share = _share((data - value).detach(), way.detach(), trust * more, trust)
        value, freedom = value + share[..., None] * way, freedom + share * more
    return value


def _share(residual: Tensor, way: Tensor, more: Tensor, trust: Tensor) -> Tensor:
    """How far to go, ``(..., 1, J)``."""
    falls = (trust * ((residual * way).sum(-1) - more)).sum(-2, keepdim=True)
    length = (trust * way.square().sum(-1)).sum(-2, keepdim=True)
    alone = (falls / torch.where(length > 0, length, 1.0)).clamp(0.0, 1.0)
    sure = length / (length + SPREAD)
    total = sure.sum(-1, keepdim=True)
    mean = (sure * alone).sum(-1, keepdim=True) / torch.where(total > 0, total, 1.0)
    share = ((falls + SPREAD * mean) / (length + SPREAD)).clamp(min=0.0)
    return ((share * SHARES + (1.0 - BETWEEN)).floor() / SHARES).clamp(max=1.0)
