"""Functions of symmetric matrices, differentiable where eigenvalues coincide."""

import torch
from torch import Tensor

__all__ = ["leading", "of_eigenvalues"]


def of_eigenvalues(
    matrix: Tensor,
    eigen: tuple[Tensor, Tensor],
    values: Tensor,
    slopes: Tensor | float = 0.0,
) -> Tensor:
    r"""A function of a symmetric matrix, known by its values at the eigenvalues.

    .. math::
        f(C) = U f(\Lambda) U^T, \quad
        df = U \big(K \circ (U^T\, dC\, U)\big) U^T, \quad
        K_{ab} = \frac{f_a - f_b}{\lambda_a - \lambda_b}, \quad K_{aa} = f'_a

    Derivatives of eigenvectors have no limit where two eigenvalues meet; this one is finite for
    every pair that the function treats alike, and is bounded for a pair that it cuts apart. The
    derivative by Daleckii and Krein stands as a term that is 0 in value. Second derivatives leave
    out how the eigenvectors turn.

    Args:
        matrix: Symmetric ``(..., n, n)``.
        eigen: Its eigenvalues ``(..., n)`` and eigenvectors, without gradient.
        values: The function at the eigenvalues ``(..., n)``, without gradient; a step where it
            changes between neighbours.
        slopes: Its derivative there, of the same shape; 0 for a projection.
    """
    known, basis = eigen
    turned = basis.mT
    result = basis @ (values[..., None] * turned)
    difference = values[..., :, None] - values[..., None, :]
    gap = known[..., :, None] - known[..., None, :]
    smallest = torch.finfo(known.dtype).eps ** 0.5 * known.abs().amax(-1)[..., None, None]
    smallest = smallest + torch.finfo(known.dtype).tiny ** 0.25
    slope = difference * gap / (gap.square() + smallest.square())
    if isinstance(slopes, Tensor):
        mean = 0.5 * (slopes[..., :, None] + slopes[..., None, :])
        slope = slope + mean * smallest.square() / (gap.square() + smallest.square())
    change = turned @ (matrix - matrix.detach()) @ basis
    return result + basis @ (slope * change) @ turned


def leading(eigenvalues: Tensor, components: float) -> Tensor:
    """Which eigenvalues, in ascending order, are kept: so many, or so much of their sum."""
    if isinstance(components, int):
        rank = torch.arange(eigenvalues.shape[-1], device=eigenvalues.device)
        kept = rank >= eigenvalues.shape[-1] - components
        return kept.expand(eigenvalues.shape).to(eigenvalues.dtype)
    positive = eigenvalues.clamp(min=0)
    larger = positive.flip(-1).cumsum(-1).flip(-1) - positive  # the sum of those before it
    share = components * positive.sum(-1, keepdim=True)
    return (larger < share).to(eigenvalues.dtype)
