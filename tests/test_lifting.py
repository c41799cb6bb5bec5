"""The lifting scheme: exact, and what the paper says of it, against loops and PyWavelets."""

import invariances
import numpy as np
import pytest
import pywt
import reference_lifting
import torch
from motions import angle_between, assert_same_rotation, numpy_of, smooth_motion
from torch import nn
from torch.autograd import gradcheck, gradgradcheck

from torchquat import LiftingStep, LiftingTransform, LinearUpdate, Pyramid, so3
from torchquat.filters.lifting import WAVELETS

LENGTHS = [*range(1, 35), 47, 63, 64, 65, 100, 127, 128, 129, 1000, 4097]


class RandomPredict(nn.Module):
    """A rotation that depends on the even frame in no sensible way, and is not of unit length."""

    def __init__(self):
        super().__init__()
        self.mix = nn.Linear(4, 4)

    def forward(self, even):
        return self.mix.to(even.dtype)(even)


class RandomUpdate(nn.Module):
    def __init__(self):
        super().__init__()
        self.mix = nn.Linear(3, 3)

    def forward(self, detail):
        return torch.tanh(self.mix.to(detail.dtype)(detail))


def about_one_axis(angles):
    half = 0.5 * torch.as_tensor(np.asarray(angles))[:, None]
    zero = torch.zeros_like(half)
    return torch.stack([zero, half.sin(), zero, half.cos()], -1)


@pytest.fixture(params=[*WAVELETS, "random"])
def wavelet(request):
    torch.manual_seed(0)
    name = request.param
    return LiftingStep(RandomPredict(), RandomUpdate()) if name == "random" else name


def test_B4_every_length_and_number_of_levels_comes_back(wavelet, rng, dtype):
    long = smooth_motion(frames=max(LENGTHS), joints=1, step=0.5, rng=rng, dtype=dtype)
    for frames in LENGTHS if dtype == torch.float64 else LENGTHS[::4]:
        q = long[:frames]
        # None is as deep as the length allows; 8 is deeper than that for most
        for levels in (1, 2, None) if frames % 8 else (0, 3, 5, 8):
            invariances.check_comes_back(LiftingTransform(wavelet, levels=levels), q)


def test_B1_nothing_comes_back(wavelet):
    transform = LiftingTransform(wavelet, levels=3)
    assert transform.inverse(transform(torch.zeros(2, 0, 3, 4))).shape == (2, 0, 3, 4)


def test_a_pyramid_goes_from_coarse_to_fine(wavelet, rng):
    approx, details = LiftingTransform(wavelet)(smooth_motion(2, frames=21, rng=rng))
    assert approx.shape == (2, 1, 3, 4)
    assert [tuple(detail.shape) for detail in details] == [(2, n, 3, 3) for n in (1, 1, 3, 5, 10)]


@pytest.mark.parametrize("name", WAVELETS)
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5, 6, 8, 13, 32])
def test_agrees_with_the_loop(name, frames, rng):
    q = smooth_motion(frames=frames, joints=2, step=0.5, rng=rng)
    approx, details = LiftingTransform(name, levels=3)(q)
    for joint in range(2):
        coarse, expected = reference_lifting.transform(numpy_of(q[:, joint]), name, 3)
        assert_same_rotation(approx[:, joint], torch.from_numpy(np.array(coarse)), 1e-10)
        for ours, theirs in zip(details, expected, strict=True):
            theirs = np.array(theirs).reshape(-1, 3)
            assert np.abs(numpy_of(ours[:, joint]) - theirs).max(initial=0.0) <= 1e-10


@pytest.mark.parametrize(("name", "theirs"), [("haar", "haar"), ("linear", "bior2.2")])
def test_about_one_axis_it_is_the_wavelet_of_the_angle(name, theirs, rng):
    """PyWavelets scales to unit length and wraps around: equal inside, up to these factors."""
    x = np.cumsum(torch.randn(256, generator=rng).numpy()).astype(np.float64) * 0.02
    approx, details = LiftingTransform(name, levels=3)(about_one_axis(x))
    expected = pywt.wavedec(x, theirs, mode="periodization", level=3)
    angle = numpy_of(so3.log(approx)[:, 0, 1])
    assert np.abs(angle - expected[0] / 2**1.5)[4:-4].max() < 1e-12
    for scale, (ours, coefficients) in zip(
        (-0.5, -0.0, 0.5), zip(details, expected[1:], strict=True), strict=True
    ):
        difference = numpy_of(ours[:, 0, 1]) + coefficients * 2.0**scale
        assert np.abs(difference)[4:-4].max() < 1e-12


def test_squad_predicts_cubic_motion_and_bezier_overshoots_it():
    t = torch.arange(40, dtype=torch.float64)
    for power, name, exact in (
        (1, "linear", True),
        (2, "linear", False),
        (3, "squad", True),
        (2, "bezier", False),
    ):
        _, (details,) = LiftingTransform(name, levels=1)(about_one_axis((t / 40) ** power))
        largest = details[2:-2].abs().max()
        assert (largest < 1e-14) if exact else (largest > 1e-5), f"{name}, t^{power}: {largest:.1e}"


@pytest.mark.parametrize("name", WAVELETS)
def test_coarse_levels_keep_the_mean_about_one_axis(name, rng):
    """The paper's claim. A motion at rest at both ends, so that the ends do not count."""
    angles = torch.zeros(256, dtype=torch.float64)
    angles[64:192] = 0.3 * torch.randn(128, generator=rng, dtype=torch.float64)
    transform = LiftingTransform(name, levels=4)
    mean = float(so3.log(transform(about_one_axis(angles)).approx)[:, 0, 1].mean())
    assert mean == pytest.approx(float(angles.mean()), abs=1e-12)


@pytest.mark.parametrize("name", WAVELETS)
def test_coarse_levels_keep_the_mean_to_first_order_elsewhere(name, rng):
    """About changing axes the mean deviates by the square of the turns, not by the turns."""
    v = torch.zeros(256, 1, 3, dtype=torch.float64)
    v[64:192] = torch.randn(128, 1, 3, generator=rng, dtype=torch.float64)
    off = []
    for size in (0.1, 0.01):
        approx = LiftingTransform(name, levels=4)(so3.exp(size * v)).approx
        off.append(float((so3.log(approx).mean(-3) - size * v.mean(-3)).norm()) / size)
    assert 0 < off[1] < 0.2 * off[0], off


def test_haar_keeps_the_mean_of_two_frames_exactly(rng):
    q = smooth_motion(frames=10, step=1.0, rng=rng)
    coarse = LiftingTransform("haar", levels=1)(q).approx
    halves = [angle_between(coarse, each) for each in (q[::2], q[1::2], q[::2])]
    whole = angle_between(q[::2], q[1::2])
    assert (halves[0] - halves[1]).abs().max() < 1e-12
    assert (halves[0] - 0.5 * whole).abs().max() < 1e-12


def test_a_step_per_level(rng):
    q = smooth_motion(rng=rng)
    torch.manual_seed(0)
    steps = [LiftingStep(RandomPredict(), LinearUpdate()) for _ in range(3)]
    transform = LiftingTransform(steps)
    pyramid = transform(q)
    assert len(pyramid.details) == 3
    assert_same_rotation(transform.inverse(pyramid), q)
    coarse, detail = steps[0](q)
    assert torch.allclose(detail, pyramid.details[-1], atol=1e-12)
    assert torch.allclose(steps[1](coarse)[1], pyramid.details[-2], atol=1e-12)
    assert len(LiftingTransform(steps[:1])(q).details) == 1
    for some in (steps, steps[:1]):
        with pytest.raises(ValueError, match=rf"one step per level \(2\), got {len(some)}"):
            LiftingTransform(some, levels=2)


@pytest.mark.parametrize("name", WAVELETS)
def test_details_follow_the_coordinate_frame(name, rng):
    """Turned from the left, nothing changes; from the right, they turn along."""
    q, (left, right) = smooth_motion(rng=rng), smooth_motion(frames=2, joints=1, rng=rng)
    transform = LiftingTransform(name)
    approx, details = transform(q)
    turned = transform(so3.compose(so3.compose(left, q), right))
    assert_same_rotation(turned.approx, so3.compose(so3.compose(left, approx), right))
    for one, other in zip(details, turned.details, strict=True):
        assert torch.allclose(so3.rotate(so3.inverse(right), one), other, atol=1e-12)


@pytest.mark.parametrize("name", WAVELETS)
def test_derivatives(name, rng):
    q = smooth_motion(frames=7, joints=1, step=0.5, rng=rng).requires_grad_()
    transform = LiftingTransform(name, levels=2)

    def both(q):
        approx, details = transform(q)
        return approx, *details, transform.inverse(Pyramid(approx, tuple(0.5 * d for d in details)))

    assert gradcheck(both, (q,), fast_mode=True)
    assert gradgradcheck(lambda q: both(q)[-1], (q,), fast_mode=True)


@pytest.mark.parametrize("name", WAVELETS)
@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_A1_A2_derivatives_at_the_identity(name, scale):
    q = torch.zeros(5, 1, 4, dtype=torch.float64)
    q[..., 3] = scale
    transform = LiftingTransform(name, levels=2)

    def both(q):
        return transform.inverse(transform(q))

    assert gradcheck(both, (q.requires_grad_(),), fast_mode=True)
    assert gradgradcheck(both, (q,), fast_mode=True)


def test_bad_options_are_named():
    with pytest.raises(ValueError, match="wavelet must be one of haar, linear, squad, bezier, got"):
        LiftingTransform("db4")
    with pytest.raises(TypeError, match="wavelet must be a name or a LiftingStep, got int"):
        LiftingTransform(3)
    with pytest.raises(ValueError, match="levels must be >= 0, got -1"):
        LiftingTransform(levels=-1)
    with pytest.raises(ValueError, match=r"q must have shape"):
        LiftingTransform()(torch.ones(5, 4))


@pytest.mark.parametrize("frames", range(1, 35))
def test_without_a_number_of_levels_one_frame_is_left(frames, rng):
    pyramid = LiftingTransform("haar")(smooth_motion(frames=frames, rng=rng))
    assert pyramid.approx.shape[0] == 1 and len(pyramid.details) == (frames - 1).bit_length()
