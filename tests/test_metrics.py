"""Figures checked on motion whose figures are known."""

import math

import pytest
import torch
from motions import random_rotations, smooth_motion
from scipy.spatial.transform import Rotation

from torchquat import metrics, so3


def about_z(angles):
    """Rotations ``(T, 1, 4)`` about one axis."""
    angles = torch.as_tensor(angles, dtype=torch.float64)[:, None]
    zero = torch.zeros_like(angles)
    return torch.stack([zero, zero, (angles / 2).sin(), (angles / 2).cos()], -1)


def test_error_of_a_known_turn(rng):
    q = random_rotations(7, 3, rng=rng)
    turned = so3.compose(q, so3.exp(torch.tensor([0.06, 0.0, 0.08]).double()))
    assert float(metrics.mean_squared_error(-turned, q)) == pytest.approx(0.01)
    assert float(metrics.geodesic_rmse_deg(turned, q)) == pytest.approx(math.degrees(0.1))
    assert float(metrics.psnr(turned, q)) == pytest.approx(10 * math.log10(math.pi**2 / 0.01))
    assert metrics.psnr(q, q) == torch.inf


def test_the_root_of_no_error_has_a_derivative(rng):
    q = random_rotations(7, 3, rng=rng).requires_grad_()
    metrics.geodesic_rmse_deg(q, q.detach()).backward()
    assert (q.grad == 0).all()


def test_error_agrees_with_scipy(rng):
    a, b = random_rotations(9, 2, rng=rng), random_rotations(9, 2, rng=rng)
    between = Rotation.from_quat(a.reshape(-1, 4).numpy()).inv() * Rotation.from_quat(
        b.reshape(-1, 4).numpy()
    )
    expected = (between.magnitude() ** 2).mean()
    assert float(metrics.mean_squared_error(a, b)) == pytest.approx(expected)


def test_derivatives_of_a_turn_about_one_axis():
    t = torch.arange(12, dtype=torch.float64) / 10
    q = about_z(0.5 * t**3)
    velocity = metrics.angular_velocity(q, frame_rate=10.0)
    assert velocity.shape == (11, 1, 3)
    assert torch.allclose(velocity[:, 0, 2], (0.5 * t**3).diff() * 10)
    acceleration = metrics.angular_acceleration(q, frame_rate=10.0)
    assert torch.allclose(acceleration[:, 0, 2], 3 * t[1:-1], atol=1e-9)
    # the third derivative of t^3 / 2
    assert float(metrics.jitter(q, frame_rate=10.0)) == pytest.approx(3.0)
    assert float(metrics.jitter(about_z(2 * t**2), frame_rate=10.0)) == pytest.approx(0.0, abs=1e-9)


def test_velocity_is_in_the_body_frame(rng):
    q, turn = random_rotations(1, 1, rng=rng), torch.tensor([0.1, 0.2, -0.3]).double()
    q = torch.cat([q, so3.compose(q, so3.exp(turn))])
    assert torch.allclose(metrics.angular_velocity(q)[0, 0], turn)


def test_peak_speed_kept():
    fast, slow = about_z([0.0, 0.1, 0.5, 0.6]), about_z([0.0, 0.1, 0.2, 0.3])
    assert float(metrics.peak_speed_kept(slow, fast)) == pytest.approx(0.25)
    still = about_z([0.0] * 4)
    assert float(metrics.peak_speed_kept(slow, still)) == 1.0
    # joints at rest do not count
    both = torch.cat([fast, still], -2), torch.cat([slow, still], -2)
    assert float(metrics.peak_speed_kept(both[1], both[0])) == pytest.approx(0.25)
    # the median ignores the pop
    assert float(metrics.peak_speed_kept(slow, fast, quantile=0.5)) == pytest.approx(1.0)


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_B1_B2_short_sequences_stand_still(frames, rng):
    q = smooth_motion(frames=4, rng=rng)[:frames]
    assert metrics.angular_velocity(q).shape[0] == max(frames - 1, 0)
    assert float(metrics.jitter(q)) == 0.0
    assert float(metrics.mean_squared_error(q, q)) == 0.0
    assert float(metrics.peak_speed_kept(q, q)) == 1.0


def test_says_what_is_wrong(rng):
    q = smooth_motion(rng=rng)
    with pytest.raises(ValueError, match=r"reference must have the shape of q, \(20, 3, 4\), got"):
        metrics.mean_squared_error(q, q[1:])
    with pytest.raises(TypeError, match=r"reference must be a torch\.Tensor, got list"):
        metrics.psnr(q, [0.0])
