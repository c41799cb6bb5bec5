"""Denoising, compression, features and editing on lifting details."""

import copy
import math

import numpy as np
import pytest
import reference_lifting
import torch
from motions import angle_between, assert_same_rotation, numpy_of, smooth_motion
from patterns import PATTERNS, with_pattern
from torch.autograd import gradcheck, gradgradcheck

from torchquat import (
    LearnedPredict,
    LearnedUpdate,
    LiftingDenoiser,
    LiftingStep,
    LiftingTransform,
    compress,
    gaussian_filter,
    lifting_denoiser,
    metrics,
    noise,
    salience,
    scale_details,
    so3,
    stored_share,
)
from torchquat.filters._thresholds import finest_noise, shrink
from torchquat.filters.lifting import WAVELETS

RULES = ("universal", "sure", "bayes", "finest", (0.1, 0.05, 0.2))
SHRINKAGES = ("soft", "hard", "garrote")


def assert_agrees(q, weight, **options):
    weights = np.ones(q.shape[:-1]) if weight is None else numpy_of(weight)
    expected = np.stack(
        [
            reference_lifting.denoise(numpy_of(q[:, j]), weights[:, j], levels=3, **options)
            for j in range(q.shape[1])
        ],
        1,
    )
    assert_same_rotation(
        lifting_denoiser(q, weight, levels=3, **options), torch.from_numpy(expected), 1e-10
    )


@pytest.mark.parametrize("wavelet", WAVELETS)
@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize("shrinkage", SHRINKAGES)
@pytest.mark.parametrize("frames", [1, 2, 6, 9, 24])
def test_agrees_with_the_loop(wavelet, rule, shrinkage, frames, rng):
    clean = smooth_motion(frames=frames, joints=2, step=0.1, rng=rng)
    q = noise.gaussian(clean, 0.05, generator=rng)
    assert_agrees(q, None, wavelet=wavelet, rule=rule, shrinkage=shrinkage)


@pytest.mark.parametrize("frames", range(1, 34))
def test_haar_of_every_length_agrees_with_the_loop(frames, rng):
    """Where a number of frames does not halve, the last one stands for the one that lacks."""
    q = smooth_motion(frames=frames, joints=2, step=0.2, rng=rng)
    assert_agrees(q, None, wavelet="haar", rule=(0.2, 0.1, 0.05), shrinkage="hard")


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize("wavelet", ["haar", "linear"])
def test_agrees_with_the_loop_where_frames_are_missing(pattern, rule, wavelet, rng):
    q, weight = with_pattern(smooth_motion(frames=23, joints=2, step=0.2, rng=rng), pattern, rng)
    assert_agrees(q, weight, wavelet=wavelet, rule=rule, shrinkage="soft")


@pytest.mark.parametrize("spins", [2, 3])
def test_several_spins_are_the_mean_of_shifted_motions(spins, rng):
    q = smooth_motion(frames=15, rng=rng)
    options = {"wavelet": "haar", "levels": 2, "rule": 0.2}
    mirrored = torch.cat([q[2:3], q[1:2], q])
    turns = [lifting_denoiser(mirrored[2 - k :], **options)[k:] for k in range(spins)]
    step = sum(so3.log(so3.relative(turns[0], other)) for other in turns) / spins
    expected = so3.compose(turns[0], so3.exp(step))
    assert_same_rotation(lifting_denoiser(q, cycle_spins=spins, **options), expected)


@pytest.mark.parametrize("rule", ["universal", "sure"])
@pytest.mark.parametrize("wavelet", ["haar", "linear"])
def test_spins_leave_missing_frames_out_of_their_estimates(wavelet, rule, rng):
    """The noise is that of the motion itself; details count as frames come to be even."""
    q = noise.gaussian(smooth_motion(frames=21, joints=1, step=0.1, rng=rng), 0.05, generator=rng)
    weight = torch.ones(21, 1, dtype=torch.bool)
    weight[[0, 5, 6, 7, 14]] = False
    options = {"wavelet": wavelet, "levels": 2, "rule": rule, "shrinkage": "soft"}
    filled, trust = reference_lifting.prepare(numpy_of(q[:, 0]), numpy_of(weight[:, 0]), False)
    sigma = reference_lifting.noise_of(filled, [w > 0 for w in trust])
    turns = []
    for shift in range(3):
        order = [*range(shift, 0, -1), *range(21)]
        of_these = np.array(filled)[order], np.array(trust)[order]
        turns.append(reference_lifting.denoise(*of_these, **options, sigma=sigma)[shift:])
    first, *others = (torch.from_numpy(turn)[:, None] for turn in turns)
    step = sum(so3.log(so3.relative(first, other)) for other in others) / 3
    expected = so3.compose(first, so3.exp(step))
    assert_same_rotation(lifting_denoiser(q, weight, cycle_spins=3, **options), expected, 1e-10)


def test_spins_bring_back_symmetry_in_time(rng):
    q = smooth_motion(frames=32, rng=rng)

    def asymmetry(spins):
        def run(q):
            return lifting_denoiser(q, wavelet="linear", levels=2, rule=0.3, cycle_spins=spins)

        return angle_between(run(q.flip(0)), run(q).flip(0))[8:-8].mean()

    one, four = asymmetry(1), asymmetry(4)
    assert four < 0.7 * one, f"{one:.3f} -> {four:.3f} rad"


@pytest.mark.parametrize("sigma", [0.002, 0.02, 0.1])
def test_the_noise_is_found(sigma, rng):
    clean = smooth_motion(frames=1, joints=2, rng=rng).expand(3000, 2, 4)
    q = noise.gaussian(clean, sigma, generator=rng)
    present = torch.ones(3000, 2, dtype=torch.bool)
    found = finest_noise(q, present)
    assert found.shape == (1, 2, 1)
    assert torch.allclose(found, torch.full_like(found, sigma), rtol=0.06), found
    q[::7] = 0.0  # what is missing says nothing
    present[::7] = False
    assert torch.allclose(finest_noise(q, present), found, rtol=0.05)


@pytest.mark.parametrize("wavelet", WAVELETS)
def test_noise_gains_are_those_of_the_scheme_on_numbers(wavelet):
    for levels in (4, 6):
        gain = LiftingDenoiser(wavelet, levels=levels).noise_gain
        assert gain == pytest.approx(reference_lifting.gains(wavelet, levels), rel=1e-12)


def test_gains_are_found_also_where_gradients_are_off():
    expected = LiftingDenoiser(levels=2).noise_gain
    with torch.inference_mode():
        assert LiftingDenoiser(levels=2).noise_gain == expected
    with torch.no_grad():
        assert LiftingDenoiser(levels=2).noise_gain == expected


def learned(rng):
    """A denoiser with a scheme of its own."""
    step = LiftingStep(LearnedPredict(), LearnedUpdate()).double()
    with torch.no_grad():
        for parameter in step.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=rng, dtype=torch.float64)
    return LiftingDenoiser(step, levels=3)


def test_B16_gains_are_those_of_what_was_loaded(rng):
    one, other = learned(rng), learned(rng)
    q = noise.gaussian(smooth_motion(frames=40, rng=rng), 0.1, generator=rng)
    other(q)
    other.load_state_dict(one.state_dict())
    assert torch.equal(other(q), one(q))


def test_as_many_levels_as_steps(rng):
    steps = [learned(rng).transform.steps[0] for _ in range(2)]
    assert LiftingDenoiser(steps).levels == len(LiftingDenoiser(steps).noise_gain) == 2


def test_gains_follow_a_scheme_that_is_trained(rng):
    run = learned(rng)
    q = noise.gaussian(smooth_motion(frames=40, rng=rng), 0.1, generator=rng)
    before = run.noise_gain
    run(q)[..., 3].sum().backward()
    assert run.noise_gain == before  # measured once
    torch.optim.SGD(run.parameters(), lr=1e-3).step()
    trained = run(q)
    assert run.noise_gain != before
    assert torch.equal(trained, copy.deepcopy(run)(q))
    assert torch.equal(trained, LiftingDenoiser(run.transform.steps[0], levels=3)(q))


def test_levels_beyond_the_clip_cost_nothing(rng):
    q = smooth_motion(frames=30, rng=rng)
    for rule in (0.1, "finest"):
        few, many = (LiftingDenoiser("haar", levels=n, rule=rule) for n in (6, 24))
        assert many(q).isfinite().all() and few(q).shape == q.shape
    assert len(LiftingDenoiser("haar", levels=12).noise_gain) == 12
    with pytest.raises(ValueError, match="levels must be <= 12 for the rule 'bayes', got 13"):
        LiftingDenoiser(levels=13, rule="bayes")


@pytest.mark.parametrize("shrinkage", SHRINKAGES)
def test_shrinkage_goes_by_the_norm(shrinkage, rng):
    v = torch.randn(50, 2, 3, generator=rng, dtype=torch.float64)
    t = torch.tensor(1.0, dtype=torch.float64)
    shorter = shrink(v, t, shrinkage)
    before, after = v.norm(dim=-1), shorter.norm(dim=-1)
    assert ((after == 0) == (before <= 1)).all()
    assert (after <= before).all()
    assert torch.allclose(torch.linalg.cross(v, shorter), torch.zeros_like(v), atol=1e-12)
    assert torch.equal(shrink(v, torch.tensor(0.0).double(), shrinkage), v)


@pytest.mark.parametrize("shrinkage", ["soft", "garrote"])
def test_derivatives_of_shrinkage_at_0_and_beyond(shrinkage, rng):
    v = torch.randn(6, 1, 3, generator=rng, dtype=torch.float64)
    v[0] = 0.0
    t = torch.tensor(0.8, dtype=torch.float64)
    inputs = (v.requires_grad_(), t.requires_grad_())
    assert gradcheck(lambda v, t: shrink(v, t, shrinkage), inputs)
    assert gradgradcheck(lambda v, t: shrink(v, t, shrinkage), inputs)


@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize("wavelet", ["haar", "linear"])
def test_derivatives(rule, wavelet, rng):
    clean = smooth_motion(frames=7, joints=1, step=0.3, rng=rng)
    q = noise.gaussian(clean, 0.1, generator=rng).requires_grad_()
    rule = (0.1, 0.05) if isinstance(rule, tuple) else rule
    module = LiftingDenoiser(wavelet, levels=2, rule=rule, cycle_spins=2)
    assert gradcheck(module, (q,), fast_mode=True)
    assert gradgradcheck(module, (q,), fast_mode=True)


@pytest.mark.parametrize("rule", ["universal", "sure", "bayes"])
@pytest.mark.parametrize("wavelet", WAVELETS)
def test_denoises_without_a_parameter(rule, wavelet, rng):
    gains, known = [], []
    for _ in range(4):
        clean = gaussian_filter(smooth_motion(frames=256, step=0.06, rng=rng), sigma_t=4.0)
        noisy = noise.gaussian(clean, 0.03, generator=rng)
        q = lifting_denoiser(noisy, wavelet=wavelet, rule=rule, cycle_spins=4)
        gains.append(float(metrics.psnr(q, clean) - metrics.psnr(noisy, clean)))
        known.append(
            float(
                metrics.psnr(gaussian_filter(noisy, sigma_t=1.0), clean)
                - metrics.psnr(noisy, clean)
            )
        )
    gain, other = np.mean(gains), np.mean(known)
    # soft shrinkage by the universal threshold takes motion along: known of old
    assert gain > (0.0 if rule == "universal" else other), f"{gain:.1f} dB, Gaussian {other:.1f} dB"


@pytest.mark.parametrize("rule", ["universal", "sure", "bayes", (0.05, 0.1)])
def test_thresholds_are_learned(rule, rng):
    module = LiftingDenoiser(rule=rule, levels=2, learnable=True)
    clean = gaussian_filter(smooth_motion(frames=200, step=0.3, rng=rng), sigma_t=2.0)
    noisy = noise.gaussian(clean, 0.05, generator=rng)
    optimiser = torch.optim.Adam(module.parameters(), lr=0.1)
    losses = []
    for _ in range(15):
        optimiser.zero_grad()
        loss = metrics.mean_squared_error(module(noisy), clean).mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert [name for name, _ in module.named_parameters()] == ["log_scale"]
    assert losses[-1] < losses[0], f"{losses[0]:.3e} -> {losses[-1]:.3e}"


@pytest.mark.parametrize("wavelet", ["haar", "linear"])
def test_what_is_learned_multiplies_the_thresholds(wavelet, rng):
    q = smooth_motion(frames=30, step=0.3, rng=rng)
    given, factors = torch.tensor([0.1, 0.05, 0.2]), torch.tensor([2.0, 3.0, 0.5])
    module = LiftingDenoiser(wavelet, levels=3, rule=given.tolist(), learnable=True)
    with torch.no_grad():
        module.log_scale.copy_(factors.log())
    expected = lifting_denoiser(q, wavelet=wavelet, levels=3, rule=(given * factors).tolist())
    assert_same_rotation(module(q), expected, 1e-6)


def test_compression_keeps_the_largest(rng):
    q = gaussian_filter(smooth_motion(frames=256, step=0.1, rng=rng), sigma_t=3.0)
    transform = LiftingTransform("squad")
    pyramid = transform(q)
    assert float(stored_share(pyramid)) == 1.0
    errors, shares = [], []
    for keep in (1.0, 0.5, 0.2, 0.05, 0.0):
        small = compress(pyramid, keep)
        shares.append(float(stored_share(small)))
        errors.append(float(angle_between(transform.inverse(small), q).mean()))
        assert shares[-1] == pytest.approx((round(keep * 255 * 3) + 3) / (256 * 3), abs=1e-12)
    assert np.all(np.diff(errors) > 0), errors
    assert errors[0] < 1e-12 and errors[2] < 0.02 < errors[-1], errors
    with pytest.raises(ValueError, match=r"keep must be in \[0, 1\], got 1\.5"):
        compress(pyramid, 1.5)


@pytest.mark.parametrize("frames", [96, 101])
def test_an_impact_is_salient(frames, rng):
    q = gaussian_filter(smooth_motion(frames=frames, step=0.05, joints=2, rng=rng), sigma_t=4.0)
    q = noise.gaussian(q, 0.002, generator=rng)
    turn = so3.exp(torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64))
    q[45:, 0] = so3.compose(q[45:, 0], turn)
    score = salience(LiftingTransform("haar", levels=4)(q))
    assert score.shape == (frames, 2)
    assert abs(int(score[:, 0].argmax()) - 45) <= 1
    assert score[:, 0].max() > 3 * score[:, 1].max()


def test_editing_by_levels(rng):
    q = smooth_motion(frames=50, rng=rng)
    transform = LiftingTransform("linear", levels=3)
    pyramid = transform(q)
    assert_same_rotation(transform.inverse(scale_details(pyramid, [1, 1, 1])), q)
    coarse = transform.inverse(scale_details(pyramid, [0, 0, 0]))
    finest = lifting_denoiser(q, levels=3, rule="finest")
    assert_same_rotation(coarse, finest)
    calm = transform.inverse(scale_details(pyramid, [1, 1, 0]))
    assert_same_rotation(calm, lifting_denoiser(q, levels=1, rule="finest"))
    with pytest.raises(ValueError, match=r"one value per level \(3\), got 2"):
        scale_details(pyramid, [1, 1])


def test_the_module_is_the_function(rng):
    q, weight = with_pattern(smooth_motion(rng=rng), "gaps", rng)
    options = {"levels": 2, "rule": "sure", "shrinkage": "hard", "cycle_spins": 2}
    module = LiftingDenoiser("squad", **options)
    assert torch.equal(module(q, weight), lifting_denoiser(q, weight, wavelet="squad", **options))
    assert "levels=2, rule='sure', shrinkage='hard', cycle_spins=2" in repr(module)
    assert "rule=[0.1, 0.2]" in repr(LiftingDenoiser(levels=2, rule=[0.1, 0.2]))
    assert LiftingDenoiser().levels == 4


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"rule": "visu"}, ValueError, "rule must be one of universal, sure, bayes, finest, got"),
        ({"rule": [0.1]}, ValueError, r"one threshold per level \(4\), got 1"),
        ({"rule": -0.1}, ValueError, r"rule must have finite thresholds >= 0, got -0\.1"),
        ({"rule": math.nan}, ValueError, "rule must have finite thresholds >= 0, got nan"),
        ({"rule": [None] * 4}, TypeError, "rule must be a name or thresholds"),
        ({"shrinkage": "firm"}, ValueError, "shrinkage must be one of soft, hard, garrote, got"),
        ({"cycle_spins": 0}, ValueError, "cycle_spins must be >= 1, got 0"),
        ({"levels": -1}, ValueError, "levels must be >= 0, got -1"),
        ({"rule": "finest", "learnable": True}, ValueError, "learnable must be False"),
    ],
)
def test_bad_options_are_named(options, error, message):
    with pytest.raises(error, match=message):
        LiftingDenoiser(**options)
