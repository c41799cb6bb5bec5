"""Lag, range of motion and places of joints, against figures known by hand and plain loops."""

import math

import numpy as np
import pytest
import torch
from motions import random_rotations, smooth_motion
from scipy.spatial.transform import Rotation
from test_metrics import about_z

from torchquat import Skeleton, metrics

LEG = Skeleton(
    ("Hip", "Knee", "Foot", "Other"),
    (-1, 0, 1, 0),
    torch.tensor([[9.0, 8.0, 7.0], [0.0, -2.0, 0.0], [0.0, -1.0, 0.5], [1.0, 0.0, 0.0]]).double(),
)


def beat(time):
    """An angle that moves once, and not like anything before or after."""
    return 0.8 * np.exp(-(((time - 30.0) / 6.0) ** 2)) + 0.3 * np.sin(0.02 * time**1.5)


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_single(kind, rng):
    """Sums of many small numbers, products of large ones, and what does not fit half at all."""
    reference = smooth_motion(frames=3000, joints=4, rng=rng, step=0.4).to(kind)
    q = smooth_motion(frames=3000, joints=4, rng=rng, step=0.4).to(kind)
    exact, known = q.double(), reference.double()
    root = torch.linspace(0.0, 5.0, 3000)[:, None].expand(-1, 3)
    for measure in (
        lambda q, r: metrics.mean_squared_error(q, r),
        lambda q, r: metrics.psnr(q, r),
        lambda q, r: metrics.lag(q, r),
        lambda q, r: metrics.jitter(q, frame_rate=240.0),
        lambda q, r: metrics.angular_acceleration(q, frame_rate=240.0).abs().max(),
        lambda q, r: metrics.peak_speed_kept(q, r, quantile=0.99),
        lambda q, r: metrics.range_of_motion_kept(q, r),
        lambda q, r: metrics.mpjpe(q, r, LEG),
        lambda q, r: metrics.foot_slide(q, LEG, root, feet=["Foot"], height=100.0),
    ):
        found, expected = measure(q, reference), measure(exact, known)
        assert found.dtype == torch.float32
        assert torch.allclose(found.double(), expected, rtol=1e-4)
    _, places = LEG.forward_kinematics(q)
    step = 4.0 * torch.finfo(kind).eps  # of numbers up to 16, half a step and a little
    assert places.dtype == kind
    assert (places.double() - LEG.forward_kinematics(exact)[1]).abs().max() < 1.01 * step


@pytest.mark.parametrize("late", [-3.0, -0.4, 0.0, 0.25, 2.5, 7.0])
def test_lag_of_a_motion_that_comes_late(late):
    time = np.arange(80.0) + 10.0
    q, reference = about_z(torch.tensor(beat(time - late))), about_z(torch.tensor(beat(time)))
    found = metrics.lag(torch.cat([q, -q], -2), torch.cat([reference, reference], -2))
    assert float(found) == pytest.approx(late, abs=0.06)


def test_lag_stops_at_the_largest_looked_for():
    time = np.arange(80.0) + 10.0
    q, reference = about_z(torch.tensor(beat(time - 7.0))), about_z(torch.tensor(beat(time)))
    assert float(metrics.lag(q, reference, max_lag=4)) == 4.0
    assert float(metrics.lag(reference, q, max_lag=4)) == -4.0


def test_no_lag_where_speeds_do_not_change():
    steady, still = about_z(0.01 * torch.arange(50).double()), about_z([0.0] * 50)
    for q, reference in ((steady, steady), (still, still), (still, steady), (steady, still)):
        assert float(metrics.lag(q, reference)) == 0.0


def test_range_of_motion():
    wide, narrow = about_z([0.1, 0.0, 0.5, -0.4, 0.2]), about_z([0.0, 0.2, -0.1, 0.1, 0.0])
    assert float(metrics.range_of_motion_kept(narrow, wide)) == pytest.approx(0.3 / 0.9)
    still = about_z([0.0] * 5)
    both = torch.cat([wide, narrow], -2), torch.cat([still, -wide], -2)
    assert float(metrics.range_of_motion_kept(*both)) == pytest.approx(1.2 / 0.9)
    assert float(metrics.range_of_motion_kept(narrow, still)) == 1.0


def places(q, root=(9.0, 8.0, 7.0)):
    """Positions ``(T, 4, 3)`` of the leg, joint by joint."""
    result = np.zeros((len(q), 4, 3))
    for frame, row in enumerate(q.numpy()):
        turn = [Rotation.from_quat(one) for one in row]
        hip = np.asarray(root[frame] if np.ndim(root) == 2 else root)
        knee = hip + turn[0].apply([0.0, -2.0, 0.0])
        foot = knee + (turn[0] * turn[1]).apply([0.0, -1.0, 0.5])
        result[frame] = hip, knee, foot, hip + turn[0].apply([1.0, 0.0, 0.0])
    return result


def test_position_and_acceleration_errors_agree_with_loops(rng):
    q, reference = random_rotations(6, 4, rng=rng), random_rotations(6, 4, rng=rng)
    error = places(q) - places(reference)
    expected = np.linalg.norm(error, axis=-1).mean()
    assert float(metrics.mpjpe(q, -reference, LEG)) == pytest.approx(expected)
    bends = [error[t + 1] - 2 * error[t] + error[t - 1] for t in range(1, 5)]
    expected = np.linalg.norm(bends, axis=-1).mean() * 900.0
    found = metrics.acceleration_error(q, reference, LEG, frame_rate=30.0)
    assert float(found) == pytest.approx(expected)


def test_position_error_of_a_knee_that_is_off_by_a_right_angle(rng):
    q = smooth_motion(joints=4, rng=rng)
    turned = q.clone()
    turned[:, 1] = torch.tensor(
        (Rotation.from_quat(q[:, 1].numpy()) * Rotation.from_euler("y", 90, degrees=True)).as_quat()
    )
    # the foot alone moves: its offset of 0.5 from the axis turns by a right angle
    assert float(metrics.mpjpe(turned, q, LEG)) == pytest.approx(0.5 * math.sqrt(2.0) / 4)


@pytest.mark.parametrize("ground", [None, 4.5])
def test_foot_slide_agrees_with_loops(rng, ground):
    q, root = smooth_motion(joints=4, rng=rng), torch.randn(20, 3, generator=rng).double()
    place = places(q, root.numpy())[:, [1, 2]][..., [2, 0, 1]]  # z is the first, y is the last
    low = place[..., 2].min() if ground is None else place[..., 2].min() + 0.3
    slides = []
    for t in range(19):
        for foot in range(2):
            h = max((place[t, foot, 2] + place[t + 1, foot, 2]) / 2 - low, 0.0)
            v = np.hypot(*(place[t + 1, foot, :2] - place[t, foot, :2])) * 24.0
            slides += [v * (2 - 2 ** (h / 1.5))] if h < 1.5 else []
    assert 5 < len(slides) < 38
    found = metrics.foot_slide(
        q,
        LEG,
        root,
        feet=["Knee", "Foot"],
        height=1.5,
        ground=None if ground is None else low,
        frame_rate=24.0,
    )
    assert float(found) == pytest.approx(np.mean(slides))


def test_foot_that_slides_at_a_known_speed():
    q = torch.tensor([0.0, 0.0, 0.0, 1.0]).double().expand(10, 4, 4)
    root = torch.zeros(10, 3).double()
    root[:, 2] = 0.03 * torch.arange(10)
    options = {"feet": ["Foot"], "height": 0.5, "up": 1, "frame_rate": 30.0}
    assert float(metrics.foot_slide(q, LEG, root, **options)) == pytest.approx(0.9)
    # 0.25 above the ground, half of H: less by 2 - sqrt(2)
    found = metrics.foot_slide(q, LEG, root, ground=-3.25, **options)
    assert float(found) == pytest.approx(0.9 * (2 - math.sqrt(2)))
    assert float(metrics.foot_slide(q, LEG, root, ground=-4.0, **options)) == 0.0


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_B1_B2_short_sequences(frames, rng):
    q = smooth_motion(joints=4, rng=rng)[:frames]
    assert float(metrics.lag(q, q)) == 0.0
    assert float(metrics.range_of_motion_kept(q, q)) == pytest.approx(1.0)
    assert float(metrics.mpjpe(q, q, LEG)) == 0.0
    assert float(metrics.acceleration_error(q, q, LEG)) == 0.0
    root = torch.zeros(frames, 3)
    assert float(metrics.foot_slide(q, LEG, root, feet=["Foot"], height=1.0)) >= 0.0


def test_says_what_is_wrong(rng):
    q = smooth_motion(joints=4, rng=rng)
    with pytest.raises(ValueError, match=r"max_lag must be >= 1, got 0\."):
        metrics.lag(q, q, max_lag=0)
    with pytest.raises(ValueError, match=r"reference must have the shape of q"):
        metrics.mpjpe(q, q[1:], LEG)
    with pytest.raises(ValueError, match=r"q must have 4 joints, got 3\."):
        metrics.acceleration_error(q[:, :3], q[:, :3], LEG)
    root = torch.zeros(20, 3)
    with pytest.raises(ValueError, match=r"joints must be of .*, got \['Toe'\]\."):
        metrics.foot_slide(q, LEG, root, feet=["Toe"], height=1.0)
    with pytest.raises(ValueError, match=r"height must be finite and > 0, got 0\."):
        metrics.foot_slide(q, LEG, root, feet=["Foot"], height=0.0)
    with pytest.raises(ValueError, match=r"up must be 0, 1 or 2, got 3\."):
        metrics.foot_slide(q, LEG, root, feet=["Foot"], height=1.0, up=3)
