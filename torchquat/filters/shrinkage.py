"""Denoising by the shrinkage of lifting details."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchquat import so3, timeline
from torchquat._checks import check_choice, check_count
from torchquat._eager import eager, visible
from torchquat.filters._haar import haar_denoised
from torchquat.filters._thresholds import (
    RULES,
    SHRINKAGES,
    Rule,
    Shrinkage,
    detail_validity,
    finest_noise,
    shrink,
    threshold,
    universal_threshold,
)
from torchquat.filters.lifting import LiftingStep, LiftingTransform, Pyramid, Wavelet

__all__ = [
    "LiftingDenoiser",
    "Rule",
    "Shrinkage",
    "lifting_denoiser",
]

DEFAULT_LEVELS = 4
MOST_LEVELS = 12  # of a rule that finds thresholds: noise is followed through 16 * 2^L frames


class LiftingDenoiser(nn.Module):
    """Module form of :func:`lifting_denoiser`; arguments as there.

    Args:
        wavelet: As in :class:`LiftingTransform`.
        levels: As in :func:`lifting_denoiser`.
        rule: As there.
        shrinkage: As there.
        cycle_spins: As there.
        learnable: Multiply the thresholds by factors that are learned, one per level, kept as
            logarithms (``log_scale``, coarsest first). Not for the rule ``"finest"``, which has
            no thresholds.

    How a learned scheme passes noise on is measured again whenever its parameters have changed;
    derivatives take it as given, and programs that were compiled or exported keep it.
    """

    log_scale: Tensor | None

    def __init__(
        self,
        wavelet: Wavelet | LiftingStep | Sequence[LiftingStep] = "linear",
        *,
        levels: int | None = None,
        rule: Rule | float | Sequence[float] = "universal",
        shrinkage: Shrinkage = "soft",
        cycle_spins: int = 1,
        learnable: bool = False,
    ) -> None:
        super().__init__()
        if levels is None:
            alone = isinstance(wavelet, str | LiftingStep)
            levels = DEFAULT_LEVELS if alone else len(wavelet)
        check_count("cycle_spins", cycle_spins, 1)
        check_choice("shrinkage", shrinkage, SHRINKAGES)
        self.transform = LiftingTransform(wavelet, levels=levels)
        self.levels = levels
        self.shrinkage: Shrinkage = shrinkage
        self.cycle_spins = cycle_spins
        self.rule: Rule | float | Sequence[float] = rule
        self.thresholds = _fixed(rule, levels)
        if learnable and self.rule == "finest":
            raise ValueError("learnable must be False for the rule 'finest': it has no thresholds.")
        self.log_scale = nn.Parameter(torch.zeros(levels)) if learnable else None
        self._estimates = isinstance(rule, str) and rule != "finest"
        if self._estimates and levels > MOST_LEVELS:
            most = f"<= {MOST_LEVELS} for the rule {rule!r}"
            raise ValueError(f"levels must be {most}, got {levels}.")
        self.noise_gain: tuple[float, ...] = ()
        self._measured_with: list[tuple[int, int]] | None = None
        self._measure()

    def _measure(self) -> None:
        """How noise comes through, unless that is known."""
        if not self._estimates or self.levels == 0:
            return
        learned = [p for p in self.transform.parameters() if not p.is_inference()]
        state = [(id(parameter), parameter._version) for parameter in learned]
        if state != self._measured_with:
            self.noise_gain = _noise_gain(self.transform, self.levels)
            self._measured_with = state

    def forward(self, q: Tensor, weight: Tensor | None = None) -> Tensor:
        """Filter unit quaternions ``(..., T, J, 4)``."""
        unit, confidence = timeline.prepare(q, weight)
        present = None if confidence is None else confidence > 0
        if eager():
            self._measure()
        sigma = finest_noise(unit, present) if self._estimates else None
        first = mean = self._spin(unit, present, sigma, 0)
        if self.cycle_spins > 1:
            step = torch.zeros_like(first[..., :3])
            for shift in range(1, self.cycle_spins):
                other = self._spin(unit, present, sigma, shift)
                step = step + so3.between(first, other) / self.cycle_spins
            mean = so3.turn(first, step)
        if present is not None:  # a joint that is missing throughout stays as it is
            mean = torch.where(present.any(-2)[..., None, :, None], mean, unit)
        return timeline.restore(mean, unit, q)

    def _spin(
        self, unit: Tensor, present: Tensor | None, sigma: Tensor | None, shift: int
    ) -> Tensor:
        """Denoise with ``shift`` frames put before the first: other frames become even."""
        frames = unit.shape[-3]
        padded, seen = unit, present
        if shift > 0:
            padded, seen = timeline.pad(unit, present, shift, "reflect")
            padded = timeline.first_frames(padded, frames + shift)
            seen = None if seen is None else timeline.first_frames(seen, frames + shift, -2)
        known = self._known_thresholds(padded, seen, sigma)
        if known is not None:
            return haar_denoised(padded, known, self.shrinkage).narrow(-3, shift, frames)
        pyramid = self.transform(padded)
        shrunk = self._shrink(pyramid.details, seen, sigma)
        whole = self.transform.inverse(Pyramid(pyramid.approx, shrunk))
        # a compiler cannot tell that the lengths are alike
        if shift == 0 and not torch.compiler.is_compiling():
            return whole
        return whole.index_select(-3, torch.arange(shift, shift + frames, device=whole.device))

    def _known_thresholds(
        self, q: Tensor, present: Tensor | None, sigma: Tensor | None
    ) -> list[Tensor] | None:
        """Thresholds, finest first, where the details need not be seen to know them.

        Of Haar's scheme, which can then be computed in one go; ``None``: of another, or by a rule
        that looks at the details, or where nobody may look at lengths.
        """
        universal = self.rule == "universal" and sigma is not None
        fast = self.transform.is_haar and (universal or self.thresholds is not None)
        # in one go, a sequence is made as long as the coarsest detail
        if not fast or self.levels == 0 or not visible(q) or 2**self.levels > 4 * q.shape[-3]:
            return None
        found: list[Tensor] = []
        frames = q.shape[-3]
        for level in range(self.levels - 1, -1, -1):
            valid, present = detail_validity(present)
            if self.thresholds is not None:
                t = q.new_full((), self.thresholds[level])
            else:
                assert sigma is not None  # for the type checker
                pairs = sigma.new_full((), float(frames // 2))
                count = pairs if valid is None else valid.to(q.dtype)[..., None].sum(-3, True)
                t = universal_threshold(count, sigma * self.noise_gain[level])
            found.append(self._rescaled(t, level))
            frames = (frames + 1) // 2
        return found

    def _rescaled(self, threshold: Tensor, level: int) -> Tensor:
        """Times the factor of a level that is learned."""
        if self.log_scale is None:
            return threshold
        return threshold * self.log_scale[level].exp().to(threshold.dtype)

    def _shrink(
        self, details: tuple[Tensor, ...], present: Tensor | None, sigma: Tensor | None
    ) -> tuple[Tensor, ...]:
        if self.rule == "finest":
            return tuple(torch.zeros_like(detail) for detail in details)
        shrunk: list[Tensor] = []
        for level in range(self.levels - 1, -1, -1):  # finest first, as frames are halved
            detail = details[level]
            valid, present = detail_validity(present)
            if isinstance(self.rule, str) and sigma is not None:
                own = sigma * self.noise_gain[level]
                t = threshold(self.rule, detail, valid, own)
            else:
                t = detail.new_full((), self.thresholds[level] if self.thresholds else 0.0)
            shrunk.insert(0, shrink(detail, self._rescaled(t, level), self.shrinkage))
        return tuple(shrunk)

    def extra_repr(self) -> str:
        """Depth, rule and options."""
        return (
            f"levels={self.levels}, rule={self.rule!r}, shrinkage={self.shrinkage!r}, "
            f"cycle_spins={self.cycle_spins}"
        )


def lifting_denoiser(
    q: Tensor,
    weight: Tensor | None = None,
    *,
    wavelet: Wavelet | LiftingStep | Sequence[LiftingStep] = "linear",
    levels: int | None = None,
    rule: Rule | float | Sequence[float] = "universal",
    shrinkage: Shrinkage = "soft",
    cycle_spins: int = 1,
) -> Tensor:
    """Shorten the details of a motion that look like noise, and put it together again.

    Details are shrunk by their norm, so the result does not depend on the coordinate frame. The
    noise is estimated per joint from the finest details; details next to a missing frame are
    shrunk too, but take no part in any estimate.

    Args:
        q: Unit quaternions ``(..., T, J, 4)``; signs may flip freely.
        weight: Confidence ``(..., T, J)``, >= 0; 0 marks a missing frame. Other values make no
            difference here.
        wavelet: As in :class:`LiftingTransform`.
        levels: How many of the finest levels are shrunk, >= 0, and <= 12 where the rule finds the
            thresholds. ``None``: 4, which is noise slower than 16 frames left alone, or one per
            given step.
        rule: ``"universal"``, ``"sure"``, ``"bayes"``, each per level and joint; ``"finest"``: all
            details of these levels are set to 0, as in the paper; or the thresholds themselves
            [rad], one for all levels or one per level, coarsest first.
        shrinkage: ``"soft"``, ``"hard"`` or ``"garrote"``.
        cycle_spins: Average over this many shifts of the motion, >= 1, in the tangent space of
            the first: then the result depends less on which frames are even.

    Returns:
        Unit quaternions ``(..., T, J, 4)``.

    Raises:
        TypeError: If ``q`` or ``weight`` is not a tensor of a fitting dtype.
        ValueError: If a shape, range or name is invalid.

    Reference:
        Szczesna, Slupik and Janiak, ICONS 2012, section VI; Coifman and Donoho, "Translation-
        invariant de-noising", 1995. The paper leaves thresholds to further research.
    """
    denoise = LiftingDenoiser(
        wavelet, levels=levels, rule=rule, shrinkage=shrinkage, cycle_spins=cycle_spins
    )
    return denoise.to(q.device)(q, weight) if isinstance(q, Tensor) else denoise(q, weight)


def _fixed(rule: Rule | float | Sequence[float], levels: int) -> tuple[float, ...] | None:
    """Given thresholds, one per level; ``None`` where a rule finds them."""
    if isinstance(rule, str):
        check_choice("rule", rule, RULES)
        return None
    values = list(rule) if isinstance(rule, Sequence) else [rule] * levels
    if len(values) != levels:
        raise ValueError(f"rule must have one threshold per level ({levels}), got {len(values)}.")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise TypeError(f"rule must be a name or thresholds [rad], got {rule!r}.")
        if not 0.0 <= value < float("inf"):
            raise ValueError(f"rule must have finite thresholds >= 0, got {rule!r}.")
    return tuple(float(value) for value in values)


def _noise_gain(transform: LiftingTransform, levels: int) -> tuple[float, ...]:
    """Standard deviation of each level's details for unit noise, coarsest first.

    By linearising the transform at rest: the gradient of one detail in the middle of a signal, of
    as many signals as there are levels.
    """
    parameter = next(transform.parameters(), torch.zeros((), dtype=torch.float64, device="cpu"))
    frames = 16 * 2**levels
    with torch.inference_mode(False), torch.enable_grad():
        v = parameter.new_zeros(levels, frames, 1, 3, requires_grad=True)
        details = transform(so3.exp(v)).details
        middle = [d[level, d.shape[-3] // 2, 0, 0] for level, d in enumerate(details)]
        (gradient,) = torch.autograd.grad(torch.stack(middle).sum(), v)
    return tuple(gradient.flatten(1).norm(dim=1).tolist())
