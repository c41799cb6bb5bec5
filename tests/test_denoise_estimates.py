"""One command cleans what a pose estimator put out."""

import denoise
import numpy as np
import pytest
import torch
from make_estimates import amass, gvhmr
from make_estimates import main as write_all
from motions import assert_same_rotation

from torchquat import GaussianFilter, io


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    write_all(tmp_path / "in")
    return tmp_path / "in"


def run(*arguments):
    return denoise.main([str(each) for each in arguments])


def test_a_folder_of_all_producers(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(folder, "--output", out, "--trust_pickle", "true") == 0
    written = {each.name for each in out.iterdir()} - {"manifest.jsonl"}
    assert written == {each.name for each in folder.iterdir()}
    lines = capsys.readouterr().out
    for producer in ("GVHMR", "WHAM", "PHALP", "SMPL"):
        assert f": {producer}; " in lines
    assert "0/pose_world: 9 frames, 72 of 216 joint samples missing (3 whole frames)" in lines


def test_it_is_the_filter_of_the_config(folder, tmp_path, capsys):
    name, out = "hmr4d_results.pt", tmp_path / "clean.pt"
    config = ("--filter.class_path", "GaussianFilter", "--filter.init_args.sigma_t", "50ms")
    assert run(folder / name, "--output", out, *config, "--frame_rate", "60") == 0
    expected = io.load_estimate(folder / name).filtered(GaussianFilter(3.0))
    found = io.load_estimate(out)
    for track, each in expected.tracks.items():
        assert_same_rotation(found.tracks[track].q, each.q, 1e-6)
    assert list(torch.load(out, weights_only=True)) == list(gvhmr())
    capsys.readouterr()


def test_pickles_are_not_read_unless_told(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(folder, "--output", out) == 0, "folders are not searched for them"
    assert not list(out.glob("*.pkl"))
    assert run(folder / "wham_output.pkl", "--output", out / "clean.pkl") == 1
    assert "expected trust_pickle=True, got False" in capsys.readouterr().err


def test_D_a_wrong_key_is_one_line(tmp_path, capsys):
    path = tmp_path / "in.npz"
    np.savez(path, global_orient=np.zeros((4, 3)), body_pose=np.zeros((4, 7)))
    assert run(path, "--output", tmp_path / "out.npz") == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "body_pose: expected floats (4, 63) or (4, 69), got float64 (4, 7)" in line


@pytest.mark.parametrize("rate", ["0", ".inf", "-1"])
def test_A23_a_frame_rate_is_positive(rate, folder, tmp_path, capsys):
    assert run(folder, "--output", tmp_path, "--frame_rate", rate) == 1
    assert "frame_rate must be finite and > 0" in capsys.readouterr().err


@pytest.mark.parametrize(("stored", "used"), [({}, 50.0), ({"fps": 25.0}, 25.0)])
def test_poses_without_the_frame_rate_of_amass(stored, used, tmp_path, capsys):
    """It is that of the key fps, else that of the command line: times are converted with it."""
    poses = amass()["poses"][:, :72]
    np.savez(tmp_path / "in.npz", poses=poses, **stored)
    config = ("--filter.class_path", "GaussianFilter", "--filter.init_args.sigma_t", "40ms")
    out = tmp_path / "out.npz"
    assert run(tmp_path / "in.npz", "--output", out, *config, "--frame_rate", "50") == 0
    assert ": SMPL; poses: 12 frames" in capsys.readouterr().out
    track = io.load_estimate(tmp_path / "in.npz").track()
    expected = GaussianFilter(0.04 * used)(track.q)
    assert_same_rotation(io.load_estimate(out).track().q, expected, 1e-6)


def test_poses_of_amass_keep_their_own_frame_rate(tmp_path, capsys):
    np.savez(tmp_path / "in.npz", **amass())
    assert run(tmp_path / "in.npz", "--output", tmp_path / "out.npz", "--frame_rate", "7") == 0
    assert "SMPL" not in capsys.readouterr().out


def test_E4_a_truncated_archive_is_what_its_reader_says(tmp_path, capsys):
    np.savez(tmp_path / "in.npz", **amass())
    (tmp_path / "in.npz").write_bytes((tmp_path / "in.npz").read_bytes()[:2000])
    assert run(tmp_path / "in.npz", "--output", tmp_path / "out.npz") == 1
    assert "in.npz: expected an npz archive, got File is not a zip" in capsys.readouterr().err
