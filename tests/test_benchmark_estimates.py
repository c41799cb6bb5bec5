"""The table of real estimates, on made-up ones."""

import benchmark_estimates
import make_estimates as made
import numpy as np
import torch
from _real_input import _in_frame_of, imu, markerless
from motions import assert_same_rotation, smooth_motion

from torchquat import so3


def test_what_is_there_is_shown(tmp_path, capsys):
    folder = tmp_path / "estimates" / "smpl_video"
    folder.mkdir(parents=True)
    np.savez(folder / "video_walk_amass.npz", **made.amass())
    arguments = ["--data", str(tmp_path), "--output", str(tmp_path / "out")]
    assert benchmark_estimates.main(arguments) == 0
    shown = capsys.readouterr().out
    assert "SMPL from video" in shown
    assert "IMU" not in shown
    assert (tmp_path / "out" / "estimates.txt").read_text() in shown


def test_nothing_there_is_one_line(tmp_path, capsys):
    assert benchmark_estimates.main(["--data", str(tmp_path)]) == 1
    assert "expected estimates/ or imu/ in it, got neither" in capsys.readouterr().err


def test_constant_turns_of_world_and_body_are_no_error(rng):
    truth = smooth_motion(frames=200, joints=1, step=0.3, rng=rng)
    world, body = smooth_motion(frames=2, joints=1, step=2.0, rng=rng)
    seen = so3.compose(so3.compose(world.expand_as(truth), truth), body.expand_as(truth))
    assert_same_rotation(_in_frame_of(seen, truth), truth, 1e-3)


def test_angles_and_markers_lie_on_one_clock(tmp_path):
    folder = tmp_path / "estimates" / "markerless"
    for name, rate in (("Method4", 60), ("Markers", 120)):
        (folder / name).mkdir(parents=True)
        time = np.arange(0.0, 2.0, 1 / rate)
        rows = np.stack([time, np.sin(time), np.full_like(time, np.nan)], -1)
        path = folder / name / "gait_participant_01.csv"
        np.savetxt(path, rows, delimiter=",", header="Time,Knee,Spine", comments="")
    (each,) = markerless(tmp_path)
    assert each.name == "Method4 gait"
    assert round(each.frame_rate) == 60
    assert each.truth is not None
    assert each.q.shape[1] == 1, "an angle that is not given is left out"
    assert_same_rotation(each.q, each.truth, 1e-4)


def test_sensors_come_scalar_first(tmp_path):
    (tmp_path / "imu").mkdir()
    wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))
    keys = ("opt_quat", "est_vqf_quat6D", "est_vqf_quat9D", "est_ahrs_madgwick9D")
    np.savez(tmp_path / "imu" / "a.npz", sampling_rate=100.0, **dict.fromkeys(keys, wxyz))
    first = next(iter(imu(tmp_path)))
    assert first.name == "vqf_quat6D"
    assert_same_rotation(first.q, torch.tensor([0.0, 0.0, 0.0, 1.0]).double().expand(5, 1, 4))
