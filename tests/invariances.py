"""What every filter on rotations must hold; each check takes the filter and raises where it fails.

A filter is a function of rotations ``(..., T, J, 4)`` and an optional weight.
"""

from collections.abc import Callable
from typing import Any, Protocol

import torch
from motions import BOUND, angle_between, assert_same_rotation, random_rotations, special_orthogonal
from torch import Tensor

Filter = Callable[..., Tensor]


class Transform(Protocol):
    """There and back."""

    def __call__(self, q: Tensor) -> Any: ...
    def inverse(self, pyramid: Any) -> Tensor: ...


def check_sign_flips(run: Filter, q: Tensor, rng: torch.Generator) -> None:
    sign = torch.randint(0, 2, (*q.shape[:-1], 1), generator=rng).to(q) * 2 - 1
    flipped = run(q * sign)
    assert_same_rotation(flipped, run(q), max(BOUND[q.dtype], 1e-12))
    inside = ((flipped * q * sign).sum(-1) >= 0).all()
    assert inside, "an output frame lies outside the hemisphere of its input frame"


def check_alternating_signs(run: Filter, rng: torch.Generator) -> None:
    """``q, -q, q, ...`` is a motion at rest."""
    q = random_rotations(3, rng=rng).expand(12, 3, 4).clone()
    q[::2] *= -1
    assert_same_rotation(run(q), q)


def check_commutes_with_rotations(run: Filter, q: Tensor, rng: torch.Generator) -> None:
    """All of SO(4): one rotation from the left and one from the right, at once."""
    turn = special_orthogonal(rng, q.dtype)
    assert_same_rotation(run(q @ turn), run(q) @ turn)


def check_joints_do_not_mix(run: Filter, q: Tensor, rng: torch.Generator) -> None:
    other = q.clone()
    other[..., 0, :] = random_rotations(*q.shape[:-2], rng=rng, dtype=q.dtype)
    assert torch.equal(run(q)[..., 1:, :], run(other)[..., 1:, :]), "joints mix"


def check_batch_does_not_mix(run: Filter, q: Tensor) -> None:
    """``q`` has one batch axis: all items at once are each item alone."""
    alone = torch.stack([run(item) for item in q])
    assert torch.equal(run(q), alone), "batch items mix"
    spoiled = torch.cat([q, torch.full_like(q[:1], torch.nan)])
    assert torch.equal(run(spoiled)[:-1], alone), "a missing batch item changes the others"


def check_time_reversal(run: Filter, q: Tensor) -> None:
    assert_same_rotation(run(q.flip(-3)), run(q).flip(-3))


def check_constant_motion(run: Filter, rng: torch.Generator, dtype: torch.dtype) -> None:
    q = random_rotations(3, rng=rng, dtype=dtype).expand(12, 3, 4)
    assert_same_rotation(run(q), q)


def check_missing_frame_stays_alone(run: Filter, q: Tensor) -> None:
    """As if it were absent: whatever stands there, the result is that of weight 0."""
    frame = q.shape[-3] // 2
    spoiled = q.clone()
    spoiled[..., frame, 0, 2] = torch.nan
    weight = torch.ones_like(q[..., 0])
    weight[..., frame, 0] = 0.0
    result = run(spoiled)
    assert result.isfinite().all(), "a missing frame spreads"
    assert_same_rotation(result, run(q, weight))


def check_missing_frame_leaves_other_joints(run: Filter, q: Tensor) -> None:
    spoiled = q.clone()
    spoiled[..., q.shape[-3] // 2, 0, 2] = torch.nan
    assert torch.equal(run(spoiled)[..., 1:, :], run(q)[..., 1:, :]), "joints mix"


def check_missing_frame_has_no_gradient(run: Filter, q: Tensor) -> None:
    frame = q.shape[-3] // 2
    spoiled = q.clone()
    spoiled[..., frame, 0, :] = torch.nan
    spoiled.requires_grad_()
    run(spoiled).square().cumsum(-1).sum().backward()
    assert spoiled.grad is not None and spoiled.grad.isfinite().all(), "gradient not finite"
    assert (spoiled.grad[..., frame, 0, :] == 0).all(), "gradient at a missing frame"


def check_scale_and_input_untouched(run: Filter, q: Tensor) -> None:
    scaled = -3.0 * q
    before, version = scaled.clone(), scaled._version
    assert_same_rotation(run(scaled), run(q), max(BOUND[q.dtype], 1e-12))
    assert torch.equal(scaled, before) and scaled._version == version, "the input was written to"


def check_output(run: Filter, q: Tensor) -> None:
    """Shape, dtype and unit length; the same twice."""
    first, second = run(q), run(q)
    assert first.shape == q.shape and first.dtype == q.dtype
    assert (first.double().norm(dim=-1) - 1).abs().max() <= BOUND[q.dtype], "not of unit length"
    assert torch.equal(first, second), "two calls differ"


def check_does_not_look_ahead(run: Filter, q: Tensor, rng: torch.Generator) -> None:
    frame = q.shape[-3] // 2
    other = q.clone()
    other[..., frame:, :, :] = random_rotations(*other[..., frame:, :, 0].shape, rng=rng)
    ahead = angle_between(run(q), run(other))[..., :frame, :]
    assert (ahead == 0).all(), "a causal filter looks ahead"


def check_comes_back(transform: Transform, q: Tensor) -> None:
    """Perfect reconstruction: a transform and its inverse give back every frame."""
    back = transform.inverse(transform(q))
    assert back.shape == q.shape, f"{q.shape[-3]} frames in, {back.shape[-3]} out"
    assert_same_rotation(back, q, BOUND[q.dtype])
