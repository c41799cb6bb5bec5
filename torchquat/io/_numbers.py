"""Numbers as text, a file's worth at a time: some times faster than one by one.

Only plain decimal numbers are handled. For any other text or value the functions return ``None``,
and the caller goes the long way, which knows what to say about it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["DECIMALS", "fixed_point", "plain_numbers"]

Numbers = NDArray[np.float64]
Counts = NDArray[np.int64]

DECIMALS = 6
"""Of angles in degrees: the rounding of three of them turns by 2.6e-8 rad at most."""

_MOST_DIGITS = 15  # of a whole number that is surely below 2^53
_ALLOWED = b"0123456789+-. \t\r\n"
_DIGITS = np.array([list(f"{n:03d}".encode()) for n in range(1000)], dtype=np.uint8)


def plain_numbers(rows: Sequence[bytes]) -> tuple[Numbers, Counts] | None:
    """All numbers of a text, to the last bit what ``float`` makes of them.

    A number of at most 15 digits is a whole number divided by a power of ten; both are exact, so
    the quotient is the nearest float.

    Args:
        rows: Lines of numbers between white space, with their ends.

    Returns:
        The numbers, and how many stand in each line; ``None`` where one of them has an exponent or
        too many digits, or is not a number.
    """
    joined = b"".join(rows)
    if joined.translate(None, _ALLOWED):
        return None
    text = np.frombuffer(b"\n" + joined + b"\n", dtype=np.uint8)
    space = text <= 32
    edges = np.flatnonzero(space[1:] != space[:-1]) + 1
    starts, ends = edges[::2], edges[1::2]
    points = np.flatnonzero(text == ord("."))
    signs = np.flatnonzero((text == ord("-")) | (text == ord("+")))
    with_point, with_sign = np.searchsorted(ends, points), np.searchsorted(starts, signs)
    if (np.diff(with_point) == 0).any() or not space[signs - 1].all():
        return None
    digits = ends - starts
    digits[with_point] -= 1
    digits[with_sign] -= 1
    if len(digits) and not 0 < digits.min() <= digits.max() <= _MOST_DIGITS:
        return None
    whole = np.fromstring(joined.replace(b".", b""), dtype=np.int64, sep=" ")
    decimals = np.zeros(len(starts), dtype=np.int64)
    decimals[with_point] = ends[with_point] - points - 1
    numbers = whole / 10.0**decimals
    numbers[(whole == 0) & (text[starts] == ord("-"))] = -0.0
    stops = np.cumsum([len(row) for row in rows], dtype=np.int64)
    return numbers, np.diff(np.searchsorted(starts, stops + 1), prepend=0)


def fixed_point(values: Numbers) -> list[bytes] | None:
    """Each row of numbers with six decimals, between single spaces.

    Args:
        values: Numbers ``(T, N)``.

    Returns:
        ``T`` texts; ``None`` where a number has more than three digits before the point.
    """
    whole = np.rint(values * 10**DECIMALS)
    if not (np.abs(whole) < 1e9).all():
        return None
    negative = whole < 0
    front, back = np.divmod(np.abs(whole).astype(np.int64), 1_000_000)
    upper, lower = np.divmod(back, 1000)
    text = np.empty((*values.shape, 12), dtype=np.uint8)
    text[..., 0] = ord("-")
    text[..., 1:4] = _DIGITS[front]
    text[..., 4] = ord(".")
    text[..., 5:8] = _DIGITS[upper]
    text[..., 8:11] = _DIGITS[lower]
    text[..., 11] = ord(" ")
    shown = np.ones(text.shape, dtype=bool)
    shown[..., 0] = negative
    shown[..., 1] = front >= 100
    shown[..., 2] = front >= 10
    shown[:, -1:, 11] = False
    stops = [0, *np.cumsum(shown.sum((1, 2))).tolist()]
    joined = text[shown].tobytes()
    return [joined[start:stop] for start, stop in pairwise(stops)]
