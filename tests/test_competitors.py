"""What people filter motion with today, against loops and libraries that share no code with it."""

import math

import numpy as np
import pytest
import reference
import reference_competitors as oracle
import torch
from motions import angle_between, assert_same_rotation, numpy_of, smooth_motion
from patterns import PATTERNS, with_pattern
from scipy import signal
from torch.autograd import gradcheck

import torchquat
from torchquat import (
    ButterworthFilter,
    HampelFilter,
    KalmanSmoother,
    KernelPCAFilter,
    MedianFilter,
    MovingMeanFilter,
    OneEuroFilter,
    PrincipalComponentFilter,
    SavitzkyGolayFilter,
    noise,
    so3,
)
from torchquat.filters.butterworth import zero_phase_mask

FILTERS = {
    "savitzky_golay": SavitzkyGolayFilter(2, 2),
    "moving_mean": MovingMeanFilter(),
    "butterworth": ButterworthFilter(0.3),
    "median": MedianFilter(1),
    "hampel": HampelFilter(1, 1.0),
    "one_euro": OneEuroFilter(0.05, 0.2, d_cutoff=0.1),
    "kalman": KalmanSmoother(0.1, 0.3),
    "principal_component": PrincipalComponentFilter(2),
    "kernel_pca": KernelPCAFilter(2, sigma=0.5),
}
TURNS = 12.0 * 2.0 * math.pi


def weights_of(q, weight):
    return np.ones(q.shape[:-1]) if weight is None else numpy_of(weight)


def agrees(run, loop, rng, *, tol=1e-10, lengths=(1, 2, 3, 7, 12), **options):
    """The filter is the loop, on every pattern of weights and gaps."""
    for frames in lengths:
        for pattern in PATTERNS:
            q, weight = with_pattern(smooth_motion(frames=frames, rng=rng, step=0.4), pattern, rng)
            expected = reference.every_joint(loop, numpy_of(q), weights_of(q, weight), **options)
            assert_same_rotation(run(q, weight), torch.from_numpy(expected), tol)


def about_one_axis(angle):
    """Rotations ``(T, 1, 4)`` by angles of any size [rad] about one axis."""
    half = 0.5 * torch.from_numpy(np.array(angle))
    axis = torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64)
    return torch.cat([half.sin()[:, None] * axis, half.cos()[:, None]], -1)[:, None]


@pytest.fixture
def angle():
    """A wild walk of many turns."""
    steps = 0.3 * np.random.default_rng(0).standard_normal(300)
    return np.cumsum(steps) + np.linspace(0.0, TURNS, 300)


@pytest.mark.parametrize(("radius", "order"), [(1, 2), (3, 2), (3, 5), (5, 3)])
def test_savitzky_golay_is_scipys_about_one_axis(radius, order, angle):
    for boundary, mode in (("interp", "interp"), ("reflect", "mirror"), ("replicate", "nearest")):
        run = SavitzkyGolayFilter(radius, order, boundary=boundary)
        expected = signal.savgol_filter(angle, 2 * radius + 1, order, mode=mode)
        assert_same_rotation(run(about_one_axis(angle)), about_one_axis(expected), 1e-11)


@pytest.mark.parametrize(("radius", "order"), [(1, 1), (3, 2), (4, 3)])
def test_savitzky_golay_fits_polynomials_to_paths(radius, order, rng):
    for frames in (2 * radius + 1, 2 * radius + 2, 20):
        q = smooth_motion(frames=frames, rng=rng, step=0.4)
        expected = reference.every_joint(
            lambda q, _: oracle.savitzky_golay(q, radius, order), numpy_of(q), weights_of(q, None)
        )
        actual = SavitzkyGolayFilter(radius, order)(q)
        assert_same_rotation(actual, torch.from_numpy(expected), 1e-10)


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5])
def test_savitzky_golay_of_fewer_frames_than_its_window(frames, rng):
    """The nearest frame stands for those that lack; where both ends meet, the mean of both fits."""
    angle = torch.randn(frames, generator=rng, dtype=torch.float64).numpy()
    time = np.arange(7)

    def fitted_from_the_start(values):
        longer = values[time.clip(max=frames - 1)]
        return np.polyval(np.polyfit(time, longer, 2), time)[:3]

    fits = np.full((2, frames), np.nan)
    for row, way in zip(fits, (1, -1), strict=True):
        here = fitted_from_the_start(angle[::way])[:frames]
        row[::way][: len(here)] = here
    actual = SavitzkyGolayFilter(3, 2)(about_one_axis(angle))
    assert_same_rotation(actual, about_one_axis(np.nanmean(fits, 0)), 1e-10)


@pytest.mark.parametrize(("radius", "order"), [(2, 2), (60, 6)])
def test_savitzky_golay_keeps_polynomials_in_windows_of_any_length(radius, order):
    place = np.arange(-radius, radius + 1) / radius
    for power in range(order + 1):
        kept = SavitzkyGolayFilter(radius, order).mask @ place**power
        assert kept == pytest.approx(float(power == 0), abs=1e-9)


@pytest.mark.parametrize(
    "share", [[31.0, 9.0, 0.0, 0.0, 3.0], [0.0, 0.0, 3.0, 5.0, 0.0]], ids=["more", "less"]
)
def test_savitzky_golay_at_an_end_of_shares_of_one_sign(share):
    """The first fit has negative shares for frames 2 and 3 alone; of one sign, it is a mean."""
    angle = np.array([0.0, 0.3, 0.2, 0.6, 0.9, 1.0, 1.0, 1.0])
    expected = about_one_axis(np.average(angle[:5, None], 0, share))
    angle[:5][np.equal(share, 0.0)] = np.nan
    assert_same_rotation(SavitzkyGolayFilter(2, 2)(about_one_axis(angle))[:1], expected, 1e-9)


@pytest.mark.parametrize("boundary", torchquat.timeline.BOUNDARIES)
def test_savitzky_golay_weighs_as_its_mask(boundary, rng):
    mask = signal.savgol_coeffs(5, 2).tolist()
    run = SavitzkyGolayFilter(2, 2, boundary=boundary)
    agrees(run, reference.linear_filter, rng, mask=mask, boundary=boundary)


@pytest.mark.parametrize(
    ("cutoff", "order"), [(0.1, 2), (0.02, 1), (0.05, 4), (0.3, 6), (0.45, 3), (0.01, 2)]
)
def test_butterworth_is_filtfilt_about_one_axis(cutoff, order, angle):
    """On its even extension; a shift of the cut-off by 1 % would be seen."""
    sections = signal.butter(order, 2.0 * cutoff, output="sos")
    expected = signal.sosfiltfilt(sections, angle, padtype="even", padlen=299)
    actual = ButterworthFilter(30.0 * cutoff, order=order, frame_rate=30.0)(about_one_axis(angle))
    middle = slice(100, 200) if cutoff < 0.05 else slice(None)  # scipy's extension ends somewhere
    assert_same_rotation(actual[middle], about_one_axis(expected)[middle], 2e-5)


def test_butterworth_halves_the_cut_off(rng):
    for cutoff, order in ((0.01, 1), (0.1, 2), (0.25, 3), (0.4, 8)):
        mask = np.array(zero_phase_mask(cutoff, order, 1.0))
        places = np.arange(len(mask)) - len(mask) // 2
        assert mask @ np.cos(2.0 * np.pi * cutoff * places) == pytest.approx(0.5, abs=1e-6)
        assert mask.sum() == pytest.approx(1.0, abs=1e-6)
    run = ButterworthFilter(0.3)
    agrees(run, reference.linear_filter, rng, mask=zero_phase_mask(0.3, 2, 1.0), lengths=(2, 12))


@pytest.mark.parametrize(
    ("cutoff", "order"), [(0.01, 1), (0.1, 2), (0.25, 3), (0.45, 2), (0.49, 2), (0.499, 1)]
)
def test_butterworth_answers_every_frequency_as_it_says(cutoff, order):
    mask = np.array(zero_phase_mask(cutoff, order, 1.0))
    places = np.arange(len(mask)) - len(mask) // 2
    frequency = np.linspace(0.0, 0.4999, 101)
    answer = np.cos(2.0 * np.pi * frequency[:, None] * places) @ mask
    ratio = np.tan(np.pi * frequency) / np.tan(np.pi * cutoff)
    expected = 1.0 / (1.0 + ratio ** (2 * order))
    assert np.abs(answer - expected).max() < 2e-8  # what is cut off, at both ends


def test_butterworth_says_what_it_is():
    said = repr(ButterworthFilter(3.0, order=3, frame_rate=30.0))
    assert "cutoff=3.0, order=3, frame_rate=30.0, boundary='reflect'" in said


def test_moving_mean_agrees_with_the_loop(rng):
    agrees(MovingMeanFilter(), oracle.moving_mean, rng, lengths=(1, 2, 4, 5, 6, 12))


@pytest.mark.parametrize("boundary", torchquat.timeline.BOUNDARIES)
def test_median_and_hampel_agree_with_the_loops(boundary, rng):
    options = {"radius": 2, "iterations": 4, "boundary": boundary}
    agrees(MedianFilter(**options), oracle.median, rng, lengths=(1, 3, 7), **options)
    options["n_sigmas"] = 1.0
    agrees(HampelFilter(**options), oracle.hampel, rng, lengths=(1, 3, 7), **options)


def test_the_median_is_where_the_distances_sum_up_to_least(rng):
    q = smooth_motion(frames=5, joints=1, step=0.5, rng=rng)
    best = MedianFilter(2, iterations=200, boundary="truncate")(q)[2]

    def total(p):
        return (so3.distance(p, q).square() + 1e-6).sqrt().sum()

    for axis in 1e-3 * torch.cat([torch.eye(3), -torch.eye(3)]).double():
        assert total(so3.turn(best, axis)) > total(best)


def test_medians_survive_what_means_do_not(rng):
    clean = smooth_motion(frames=60, step=0.02, rng=rng)
    spoiled = noise.impulse(clean, 1.0, share=0.05, generator=rng)
    for run in (MedianFilter(3), HampelFilter(3)):
        left = angle_between(run(spoiled), clean)
        assert left.max() < 0.2, f"{left.max():.2f} rad"
    kept = angle_between(HampelFilter(3, 4.0)(clean), clean) < 1e-12
    assert kept.float().mean() > 0.98, f"{kept.float().mean():.3f}"


def test_one_euro_agrees_with_the_loop(rng):
    settings = {"min_cutoff": 1.5, "beta": 0.7, "d_cutoff": 3.0, "frame_rate": 30.0}
    agrees(OneEuroFilter(**settings), oracle.one_euro, rng, **settings)


def test_one_euro_in_a_gap_has_not_even_a_sign_from_what_comes():
    """So slow that what the gap is filled with comes to lie in the other hemisphere."""
    run = OneEuroFilter(1e-3, 0.0)
    one, other = (
        run(about_one_axis(np.array([0.0, 1.2, 2.4, np.nan, after]))) for after in (2.4, 5.0)
    )
    assert torch.equal(one[:4], other[:4])


@pytest.mark.parametrize("order", [2, 3])
def test_kalman_agrees_with_the_loop(order, rng):
    settings = {"process_noise": 0.1, "measurement_noise": 0.3, "order": order}
    agrees(KalmanSmoother(**settings), oracle.kalman, rng, tol=1e-6, **settings)


@pytest.mark.parametrize("process_noise", [0.05, 20.0])
@pytest.mark.parametrize("order", [2, 3])
def test_kalman_is_least_squares_about_one_axis(order, process_noise):
    """The smoother's path is the one of least cost: of measurements, and of changes of pace."""
    random = np.random.default_rng(1)
    frames, measurement_noise = 40, 0.2
    angle = np.cumsum(0.4 + 0.3 * random.standard_normal(frames))
    weight = random.uniform(0.1, 3.0, frames)
    weight[[7, 8, 9, 20]] = 0.0
    power = np.arange(order)
    step = np.array(
        [[1.0 / math.factorial(max(b - a, 0)) if b >= a else 0.0 for b in power] for a in power]
    )
    exponent = 2 * order - 1 - power[:, None] - power
    scale = np.array([math.factorial(order - 1 - a) for a in power])
    process = process_noise**2 / (exponent * scale[:, None] * scale)
    root = np.linalg.inv(np.linalg.cholesky(process))
    rows, wanted = [], []
    for t in range(frames):
        row = np.zeros((1, frames * order))
        row[0, t * order] = np.sqrt(weight[t]) / measurement_noise
        rows.append(row)
        wanted.append([row[0, t * order] * angle[t]])
        if t:
            row = np.zeros((order, frames * order))
            row[:, t * order : (t + 1) * order] = root
            row[:, (t - 1) * order : t * order] = -root @ step
            rows.append(row)
            wanted.append(np.zeros(order))
    state = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    run = KalmanSmoother(process_noise, measurement_noise, order=order)
    actual = run(about_one_axis(angle), torch.from_numpy(weight)[:, None])
    assert_same_rotation(actual, about_one_axis(state[::order]), 1e-5)


@pytest.mark.parametrize("name", FILTERS)
def test_derivatives(name, rng):
    q = smooth_motion(frames=6, joints=1, step=0.3, rng=rng).requires_grad_()
    weight = torch.rand(6, 1, generator=rng, dtype=q.dtype) + 0.5
    assert gradcheck(FILTERS[name], (q, weight.detach()), eps=1e-6, atol=1e-5, rtol=1e-3)


@pytest.mark.parametrize("name", ["one_euro", "kalman"])
def test_recursions_keep_their_precision_in_float32(name, rng):
    """Confidences of many sizes magnify rounding; a product of many turns leaves the sphere."""
    q = smooth_motion(frames=300, joints=2, rng=rng, dtype=torch.float32)
    weight = 10.0 ** (4.0 * torch.rand(300, 2, generator=rng) - 4.0)
    actual = FILTERS[name](q, weight)
    assert_same_rotation(actual, FILTERS[name](q.double(), weight.double()).float(), 5e-6)
    assert (actual.norm(dim=-1) - 1).abs().max() < 5e-7


@pytest.mark.parametrize("name", FILTERS)
def test_fast_turns_are_followed(name):
    """Two radians a frame, many times around: constant angular velocity is left as it is."""
    if name in ("one_euro", "principal_component", "kernel_pca"):
        return  # lags on purpose; or takes time for no order at all
    q = about_one_axis(2.0 * np.arange(160.0))
    off = angle_between(FILTERS[name](q), q)[50:-50]
    assert off.max() < 1e-6, f"{off.max():.1e} rad"


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: SavitzkyGolayFilter(1, 3), r"order must be <= 2 radius = 2, got 3\."),
        (lambda: ButterworthFilter(0.5), r"cutoff must be < frame_rate / 2 = 0.5, got 0.5\."),
        (
            lambda: ButterworthFilter(0.4999999),
            r"cutoff must lie 3\.8e-05 or more from 0 and from frame_rate / 2 = 0\.5 for order 2, "
            r"got 0\.4999999\.",
        ),
        (
            lambda: ButterworthFilter(3e-4, frame_rate=30.0),
            r"cutoff must lie 0\.0011 or more from 0 and from frame_rate / 2 = 15 for order 2, got",
        ),
        (lambda: HampelFilter(1, 0.0), "n_sigmas must be"),
        (lambda: OneEuroFilter(1.0, -1.0), r"beta must be finite and >= 0, got -1\.0\."),
        (lambda: KalmanSmoother(1.0, 1.0, order=4), r"order must be 2 or 3, got 4\."),
        (lambda: PrincipalComponentFilter(1.5), r"share in \(0, 1\), got 1\.5\."),
        (lambda: PrincipalComponentFilter(1.0), r"share in \(0, 1\), got 1\.0\."),
        (lambda: PrincipalComponentFilter(0.0), r"share in \(0, 1\), got 0\.0\."),
    ],
)
def test_A23_parameters_out_of_range(build, message):
    with pytest.raises(ValueError, match=message):
        build()
