"""Szczesna's quaternion lifting scheme: an invertible wavelet transform of rotations."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor, nn

from torchquat import so3, timeline
from torchquat._checks import check_choice, check_count
from torchquat._eager import lowest
from torchquat.filters._prediction import (
    BezierPredict,
    HaarPredict,
    HaarUpdate,
    LinearPredict,
    LinearUpdate,
    SquadPredict,
)
from torchquat.filters.learned import LearnedPredict

__all__ = [
    "BezierPredict",
    "HaarPredict",
    "HaarUpdate",
    "LiftingStep",
    "LiftingTransform",
    "LinearPredict",
    "LinearUpdate",
    "Pyramid",
    "SquadPredict",
    "Wavelet",
    "lifting_step",
]

Wavelet = Literal["haar", "linear", "squad", "bezier"]
WAVELETS: tuple[Wavelet, ...] = get_args(Wavelet)


class Pyramid(NamedTuple):
    """A motion at several resolutions.

    Attributes:
        approx: The coarsest motion, unit quaternions ``(..., ceil(T / 2^L), J, 4)``.
        details: What each level adds, coarsest first: rotation vectors ``(..., N, J, 3)`` [rad].
    """

    approx: Tensor
    details: tuple[Tensor, ...]


class LiftingStep(nn.Module):
    r"""One level of a lifting scheme, invertible whatever its two modules compute.

    .. math::
        d_i = \log(\mathrm{predict}(e)_i^{-1} o_i), \quad c_i = e_i \exp(\mathrm{update}(d)_i)

    with the even frames e and the odd frames o.

    Args:
        predict: From even frames ``(..., N, J, 4)`` to a rotation for the odd frame after each,
            same shape; scaled to unit length here. It gets quaternions with ``w >= 0``. The last
            one is dropped where no odd frame follows.
        update: From details ``(..., N, J, 3)`` to a rotation vector for every even frame, same
            shape. Where the last even frame has no odd one, its detail is 0.

    Reference:
        Szczesna, Slupik and Janiak, "Quaternion Lifting Scheme for Multi-resolution Wavelet-based
        Motion Analysis", ICONS 2012, section V. The printed inverse of the linear scheme repeats
        the exponent 0.5 of the update: it must be -0.5. The paper's Haar detail is half of ours,
        conjugated.
    """

    def __init__(self, predict: nn.Module, update: nn.Module) -> None:
        super().__init__()
        self.predict = predict
        self.update = update

    def forward(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Split unit quaternions ``(..., T, J, 4)``.

        Returns:
            Coarse unit quaternions ``(..., ceil(T / 2), J, 4)`` and details
            ``(..., floor(T / 2), J, 3)`` [rad].
        """
        even, odd = timeline.halves(q)
        detail = so3.between(self._predicted(even, odd.shape[-3]), odd)
        if self.is_haar and not torch.compiler.is_compiling():  # the middle, in fewer steps
            pairs = odd.shape[-3]
            middle = so3.midpoint(even[..., :pairs, :, :], odd)
            return _followed(middle, even[..., pairs:, :, :]), detail
        return so3.turn(even, self._step(detail, even.shape[-3])), detail

    def inverse(self, coarse: Tensor, detail: Tensor) -> Tensor:
        """Put together what :meth:`forward` split: unit quaternions ``(..., T, J, 4)``."""
        evens, odds = coarse.shape[-3], detail.shape[-3]
        if self.is_haar and not torch.compiler.is_compiling():  # one turn, both ways
            middle, last = coarse[..., :odds, :, :], coarse[..., odds:, :, :]
            odd, even = so3.turn_both_ways(middle, self.update(detail))
            return timeline.interleave(_followed(even, last), odd)
        even = so3.turn(coarse, -self._step(detail, evens))
        odd = so3.turn(self._predicted(even, odds), detail)
        return timeline.interleave(even, odd)

    @property
    def is_haar(self) -> bool:
        """Whether this is Haar's scheme."""
        return type(self.predict) is HaarPredict and type(self.update) is HaarUpdate

    def _predicted(self, even: Tensor, odds: int) -> Tensor:
        if type(self.predict) in _UNIT:
            return timeline.first_frames(self.predict(even), odds)
        # one sign for both ways: a frame may come back as -q, and a module may care
        if not lowest(even[..., 3]) >= 0:  # also where it cannot be seen
            even = torch.where(even[..., 3:] < 0, -even, even)
        return so3.normalize(timeline.first_frames(self.predict(even), odds))

    def _step(self, detail: Tensor, evens: int) -> Tensor:
        return self.update(_lengthened(detail, evens))


class LiftingTransform(nn.Module):
    """Wavelet transform of rotations, exact for every length and number of levels.

    ``inverse(forward(q))`` are the rotations of ``q``, up to rounding (and the sign of the
    quaternions). It is for whole motions: fill missing frames first, :func:`fill_missing`.

    Args:
        wavelet: ``"haar"``, ``"linear"``, ``"squad"``, ``"bezier"``, or a :class:`LiftingStep`
            used on every level, or a sequence of one per level, finest first.
        levels: How often the coarse motion is split again, >= 0. ``None``: until one frame is
            left. More levels than that have empty details.

    Raises:
        TypeError: If ``wavelet`` or ``levels`` has another type.
        ValueError: If the name is unknown, or there is not one step per level.

    Reference:
        Szczesna, Slupik and Janiak, ICONS 2012; squad and Bezier are its future work.
    """

    def __init__(
        self,
        wavelet: Wavelet | LiftingStep | Sequence[LiftingStep] = "linear",
        *,
        levels: int | None = None,
    ) -> None:
        super().__init__()
        if levels is not None:
            check_count("levels", levels, 0)
        self.steps = nn.ModuleList(_steps(wavelet))
        if len(self.steps) > 1 or (isinstance(wavelet, Sequence) and not isinstance(wavelet, str)):
            levels = len(self.steps) if levels is None else levels
            if len(self.steps) != levels:
                raise ValueError(
                    f"wavelet must have one step per level ({levels}), got {len(self.steps)}."
                )
        self.levels = levels

    def forward(self, q: Tensor) -> Pyramid:
        """Split a motion.

        Args:
            q: Unit quaternions ``(..., T, J, 4)``, without missing frames; need not be of unit
                length. float16 and bfloat16 are split in float32.

        Returns:
            The :class:`Pyramid`.

        Raises:
            TypeError: If ``q`` is not a floating-point tensor.
            ValueError: If its shape is another.
        """
        approx, _ = timeline.prepare(q)
        levels = (q.shape[-3] - 1).bit_length() if self.levels is None else self.levels
        details = []
        for level in range(levels):
            approx, detail = lifting_step(self.steps, level)(approx)
            details.append(detail)
        return Pyramid(approx, tuple(reversed(details)))

    def inverse(self, pyramid: Pyramid) -> Tensor:
        """Put a motion together from what :meth:`forward` made of it, or from edited details.

        Args:
            pyramid: Coarsest motion and details.

        Returns:
            Unit quaternions ``(..., T, J, 4)``.
        """
        q, details = pyramid
        for level, detail in zip(range(len(details) - 1, -1, -1), details, strict=True):
            q = lifting_step(self.steps, level).inverse(q, detail)
        return q

    @property
    def is_haar(self) -> bool:
        """Whether every level is Haar's scheme."""
        return all(isinstance(step, LiftingStep) and step.is_haar for step in self.steps)

    def extra_repr(self) -> str:
        """Depth."""
        return f"levels={self.levels}"


def lifting_step(steps: nn.ModuleList, level: int) -> LiftingStep:
    """The step of a level, 0 the finest; one step alone serves all."""
    step = steps[level if len(steps) > 1 else 0]
    assert isinstance(step, LiftingStep)  # for the type checker: a ModuleList forgets
    return step


def _steps(wavelet: Wavelet | LiftingStep | Sequence[LiftingStep]) -> list[LiftingStep]:
    """Steps by name, alone or in a row."""
    if isinstance(wavelet, str):
        check_choice("wavelet", wavelet, WAVELETS)
        if wavelet == "haar":
            return [LiftingStep(HaarPredict(), HaarUpdate())]
        predict = {"linear": LinearPredict, "squad": SquadPredict, "bezier": BezierPredict}[wavelet]
        return [LiftingStep(predict(), LinearUpdate())]
    steps = list(wavelet) if isinstance(wavelet, Sequence) else [wavelet]
    for step in steps:
        if not isinstance(step, LiftingStep):
            raise TypeError(f"wavelet must be a name or a LiftingStep, got {type(step).__name__}.")
    return steps


_UNIT = (HaarPredict, LinearPredict, SquadPredict, BezierPredict, LearnedPredict)
"""Predictions that are of unit length, and the same rotations whatever the signs of the frames."""


def _followed(q: Tensor, last: Tensor) -> Tensor:
    """``q`` and the frame, if there is one, that has no partner."""
    if last.shape[-3] == 0:
        return q
    return torch.cat([q.movedim(-1, 0), last.movedim(-1, 0)], -2).movedim(0, -1)


def _lengthened(x: Tensor, frames: int) -> Tensor:
    """Put zeros after the last frame, where ``x`` is one frame shorter than ``frames``."""
    if not torch.compiler.is_compiling() and x.shape[-3] == frames:
        return x
    zero = torch.zeros_like(x.sum(-3, keepdim=True))  # also where x is empty
    return timeline.first_frames(torch.cat([x, zero], -3), frames)
