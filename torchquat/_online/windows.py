"""What a window says of one of its frames: the rules of windowed filters, for one frame."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchquat._eager import highest
from torchquat._online import rotations
from torchquat.filters.robust import PER_AXIS, ROUNDING, weighted_median

__all__ = ["Centre", "bilateral", "hampel", "masked", "median"]

Centre = Callable[[Tensor, Tensor | None], Tensor]
"""From frames ``(4, P, W, J)`` and weights ``(P, W, J)`` (``None``: 1) to one frame ``(4, P, J)``;
each quaternion lies in the hemisphere of the one before."""


def masked(mask: Tensor, past: int) -> Centre:
    """A mask ``(W, J or 1)`` on the increments, as :func:`torchquat.linear_filter` has it.

    Args:
        mask: Coefficients of the frames of the window, with the sum 1.
        past: Frames of the window before the filtered one.
    """
    plain = _on_increments(mask, past)[0]
    rising, falling = mask.clamp(min=0), -mask.clamp(max=0)
    gain, loss = rising.sum(0), -falling.sum(0)
    one_sign = bool((mask >= 0).all())

    def centre(q: Tensor, trust: Tensor | None) -> Tensor:
        if trust is None:
            return _moved(q, plain, past)
        ups, up_total = _on_increments(rising * trust, past)
        if one_sign:
            return _moved(q, ups, past)
        downs, down_total = _on_increments(falling * trust, past)
        # where one sign has no frame left, the other stands for both
        up, down = torch.where(up_total > 0, ups, downs), torch.where(down_total > 0, downs, ups)
        return _moved(q, gain * up + loss * down, past)

    return centre


def bilateral(
    past: int,
    future: int,
    sigma_t: float | Tensor,
    sigma_g: float | Tensor,
    gaussian: bool,
    like: Tensor,
) -> Centre:
    """Weights by time and by angle, as :func:`torchquat.bilateral_filter` has them."""
    lag = torch.arange(-past, future + 1, dtype=like.dtype, device=like.device).abs()[:, None]
    in_time = -0.5 * ((lag / sigma_t) ** 2 if gaussian else lag / sigma_t**2)
    # a quarter of the angle; the paper's kernel has half of it, unsquared
    rate = torch.as_tensor(
        (-8.0 if gaussian else -1.0) / sigma_g**2, dtype=like.dtype, device=like.device
    )

    def centre(q: Tensor, trust: Tensor | None) -> Tensor:
        here = q[..., past : past + 1, :]
        quarter = rotations.quarter_angle(rotations.squared_norm(q - here))
        reach = quarter * quarter if gaussian else quarter
        m = torch.addcmul(in_time, reach, rate).exp_()
        return _moved(q, _on_increments(m if trust is None else m * trust, past)[0], past)

    return centre


def median(past: int, iterations: int) -> Centre:
    """The geodesic median of the window, as :func:`torchquat.median_filter` has it."""

    def centre(q: Tensor, trust: Tensor | None) -> Tensor:
        estimate = q[..., past, :]
        for iteration in range(iterations + 1 if q.shape[-2] > 1 else 0):
            estimate = _nearer_median(estimate, q, trust, reweighted=iteration > 0)
        return estimate

    return centre


def hampel(past: int, n_sigmas: float, iterations: int) -> Centre:
    """The median where the frame stands out, as :func:`torchquat.hampel_filter` has it."""
    middle = median(past, iterations)
    bound = (n_sigmas * PER_AXIS) ** 2

    def centre(q: Tensor, trust: Tensor | None) -> Tensor:
        found = middle(q, trust)
        square = rotations.squared_norm(q - found[..., None, :])
        squares = rotations.quarter_angle(square).square_().movedim(-2, 0)
        if trust is None:
            typical = squares.median(0).values
        else:
            typical = weighted_median(squares, trust.movedim(-2, 0))
        return torch.where(squares[past] > bound * typical, found, q[..., past, :])

    return centre


def _on_increments(m: Tensor, past: int) -> tuple[Tensor, Tensor]:
    """What weights ``(..., W, J)`` of frames make of the increments between them.

    Returns:
        Coefficients ``(..., W - 1, J)`` whose products with the increments sum to the mean of the
        paths from the filtered frame, 0 where nothing weighs, and the sums of the weights.
    """
    summed = m.cumsum(-2)
    total = summed[..., -1:, :]
    divisor = total.clamp(min=torch.finfo(m.dtype).tiny)
    coefficients = summed[..., :-1, :].neg()
    coefficients[..., past:, :] += total
    return coefficients.div_(divisor), total


def _moved(q: Tensor, coefficients: Tensor, past: int) -> Tensor:
    """The filtered frame, turned by a sum of increments."""
    steps = rotations.between(q[..., :-1, :], q[..., 1:, :])
    return rotations.turn(q[..., past, :], (coefficients * steps).sum(-2))


def _nearer_median(p: Tensor, q: Tensor, trust: Tensor | None, *, reweighted: bool) -> Tensor:
    """One step of Weiszfeld's iteration, or the step to the mean."""
    here = p[..., None, :]
    apart = q - here
    square = rotations.squared_norm(apart)
    if not highest(square) <= 2.0:  # of q and -q, the nearer
        apart = rotations.nearer(q, here) - here
        square = rotations.squared_norm(apart)
    quarter, m = rotations.angle_and_factor(square)
    total = None
    if reweighted:
        pull = (quarter * quarter).mul_(16.0).add_(ROUNDING**2).rsqrt_()
        pull = pull if trust is None else pull * trust
        m, total = pull * m, pull.sum(-2)
    elif trust is not None:
        m, total = trust * m, trust.sum(-2)
    mean = (m * apart).sum(-2)
    if total is None:
        mean = mean / q.shape[-2]
    else:
        mean = mean / torch.where(total > 0, total, 1.0)
    tangent = rotations.tangent_part(p, mean)
    return rotations.turn_along(p, tangent, rotations.squared_norm(tangent).sqrt_())
