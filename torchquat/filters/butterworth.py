"""Butterworth's low-pass filter on rotations, without delay."""

import numpy as np
from torch import Tensor, nn

from torchquat._checks import check_choice, check_count, check_positive
from torchquat.filters.linear import linear_filter
from torchquat.timeline import BOUNDARIES, Boundary

__all__ = ["ButterworthFilter", "butterworth_filter"]

TAIL = 1e-8
"""Share of the mask that may lie outside the window."""
LONGEST = 2**22  # frames of a response, before what is next to nothing is cut off


def butterworth_filter(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    cutoff: float,
    order: int = 2,
    frame_rate: float = 1.0,
    boundary: Boundary = "reflect",
) -> Tensor:
    r"""Low-pass filter, run forward and backward, so that nothing lags behind.

    .. math::
        \hat q_i = q_i \exp\Big(\sum_j m_j (c_{i+j} - c_i)\Big), \quad
        \sum_j m_j e^{-2\pi i f j} =
        \Big(1 + \Big(\frac{\tan \pi f}{\tan \pi f_c}\Big)^{2n}\Big)^{-1}

    with :math:`c` the running sum of the increments :math:`\log(q_i^{-1} q_{i+1})`. The right-hand
    side is the squared magnitude of the digital filter that the bilinear transform makes: what one
    pass forward and one backward multiply a frequency by. At the cut-off it is 1/2, or 6 dB.

    The response is taken as a symmetric mask, cut off where less than 1e-8 of it is left, instead
    of a recursion over frames: confidences and missing frames act as in :func:`linear_filter`, sums
    do not grow with the length of the sequence, and every frame is filtered at once. The half-width
    is about ``3 / cutoff`` frames at order 2 and grows in proportion to the order.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame.
        cutoff: Frequency :math:`f_c` that is halved, in (0, frame_rate / 2) [Hz; cycles per frame
            at the default frame rate].
        order: Order n of the filter in each direction, >= 1.
        frame_rate: Frames per second, > 0.
        boundary: Rule at both ends of the sequence; ``"reflect"`` is the even extension of
            ``scipy.signal.filtfilt``. Its default, the odd one, would keep the end frames' noise.

    Returns:
        Unit quaternions ``(..., T, J, 4)``. Extra memory is O(T J), whatever the cut-off.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range or boundary name is invalid.

    Reference:
        Butterworth, Experimental Wireless 1930; Lee and Shin, IEEE TVCG 2002. A row of Dean,
        "Non-local Pose Means", Table I.
    """
    mask = zero_phase_mask(cutoff, order, frame_rate)
    return linear_filter(q, weight, mask=mask, boundary=boundary)


class ButterworthFilter(nn.Module):
    """Module form of :func:`butterworth_filter`; arguments as there."""

    def __init__(
        self,
        cutoff: float,
        *,
        order: int = 2,
        frame_rate: float = 1.0,
        boundary: Boundary = "reflect",
    ) -> None:
        super().__init__()
        check_choice("boundary", boundary, BOUNDARIES)
        self.cutoff = cutoff
        self.order = order
        self.frame_rate = frame_rate
        self.boundary: Boundary = boundary
        self.mask = zero_phase_mask(cutoff, order, frame_rate)

    @property
    def radius(self) -> int:
        """Half-width of the mask [frames]."""
        return len(self.mask) // 2

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        return linear_filter(q, weight, mask=self.mask, boundary=self.boundary)

    def extra_repr(self) -> str:
        """Cut-off, order and boundary."""
        return (
            f"cutoff={self.cutoff}, order={self.order}, frame_rate={self.frame_rate}, "
            f"boundary={self.boundary!r}"
        )


def zero_phase_mask(cutoff: float, order: int, frame_rate: float) -> list[float]:
    """Impulse response of the filter in both directions, ``m_{-k}, ..., m_k``.

    Raises:
        TypeError: If an argument is not a number.
        ValueError: If one is out of its range.
    """
    check_positive("frame_rate", frame_rate)
    check_positive("cutoff", cutoff)
    check_count("order", order, 1)
    if not cutoff < frame_rate / 2:
        raise ValueError(f"cutoff must be < frame_rate / 2 = {frame_rate / 2:g}, got {cutoff}.")
    relative = cutoff / frame_rate
    # the slowest mode, at the cut-off or as far from half the frame rate, decays by e in less than
    # order / 4 of its periods: the response has decayed by e^80 where it wraps around
    size = 2 ** int(np.ceil(np.log2(80 * order / min(relative, 0.5 - relative))))
    if size > LONGEST:
        least = 80 * order / LONGEST * frame_rate
        raise ValueError(
            f"cutoff must lie {least:.2g} or more from 0 and from frame_rate / 2 = "
            f"{frame_rate / 2:g} for order {order}, got {cutoff}."
        )
    tangent = np.tan(np.pi * np.arange(size // 2 + 1) / size)
    # in logarithms: high powers of large ratios overflow
    with np.errstate(divide="ignore"):
        exponent = 2 * order * (np.log(tangent) - np.log(np.tan(np.pi * relative)))
    half = np.fft.irfft(1.0 / (1.0 + np.exp(np.minimum(exponent, 700.0))))[: size // 2]
    left = np.abs(half[::-1]).cumsum()[::-1]  # from each place outward
    radius = int(np.argmax(left < TAIL)) - 1
    half = half[: radius + 1]
    return [*half[:0:-1].tolist(), *half.tolist()]
