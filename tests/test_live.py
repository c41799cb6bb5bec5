"""The example that plays a motion through a stream, and the one that times streams."""

import re
import time
from pathlib import Path

import benchmark_stream
import live
import pytest
import torch
from bvh_files import one_joint
from motions import assert_same_rotation

from torchquat import BilateralFilter, GaussianFilter, Stream, io

ROOT = Path(__file__).parents[1]
ONE_EURO = str(ROOT / "configs" / "one_euro.yaml")


def test_live_plays_the_demo(tmp_path, capsys):
    out = tmp_path / "plots" / "live.png"
    assert live.main(["--fast", "--output", str(out)]) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    said = capsys.readouterr().out
    assert "230 frames at 30 fps, BilateralFilter: latency 400 ms (12 frames)" in said
    before, after = (
        float(x.replace(",", "")) for x in re.search(r"([\d,]+) -> ([\d,]+)", said).groups()
    )
    assert after < 0.25 * before  # as the README has it of the same filter offline
    assert str(out) in said


def test_live_with_another_filter_joint_and_no_output(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--fast", "--config", ONE_EURO, "--joint", "RightLeg"]
    assert live.main([*arguments, "--filter.init_args.beta", "0.1"]) == 0
    assert "OneEuroFilter: latency 0 ms (0 frames)" in capsys.readouterr().out
    assert (tmp_path / "out" / "live.png").exists()


def test_what_is_played_comes_out_in_time_and_as_offline(monkeypatch):
    """At the frame rate, and drawn along the way where there is a window."""
    pauses = []
    monkeypatch.setattr(live.plt, "pause", pauses.append)
    monkeypatch.setattr(live, "REDRAWN", 0.02)
    motion = io.load(live.DEMO)
    motion = live.Motion(motion.q[10:40], 200.0, motion.names, weight=motion.weight[10:40])
    run = BilateralFilter(1.0, 0.5)
    scope, start = live.Scope(motion, 3, "title"), time.perf_counter()
    played = live.play(motion, Stream(run), scope, fast=False, window=True)
    assert time.perf_counter() - start >= 29 / 200
    assert pauses and len(played.times) == 30
    known = motion.valid
    assert_same_rotation(played.q[known], run(motion.q, motion.weight)[known], 1e-9)
    shown = torch.tensor(scope.after.get_ydata())
    assert shown.shape == (30,) and shown.isfinite().all()
    live.plt.close(scope.figure)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--joint", "Tail"], "joint must be one of Hips, "),
        (
            ["--config", str(ROOT / "configs" / "default.yaml")],
            "default.yaml: filter must see a window",
        ),
        (["--filter.init_args.boundary", "circular"], "boundary must be known before"),
        (["nothing.bvh"], "nothing.bvh"),
    ],
)
def test_live_says_what_is_wrong(extra, message, tmp_path, capsys):
    assert live.main(["--fast", "--output", str(tmp_path / "x.png"), *extra]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_live_plays_one_frame(tmp_path, capsys):
    path, out = tmp_path / "one.bvh", tmp_path / "live.png"
    path.write_text(one_joint("1 2 3"))
    assert live.main([str(path), "--fast", "--output", str(out)]) == 0
    assert out.exists() and "1 frames at " in capsys.readouterr().out


def test_live_needs_frames(tmp_path, capsys):
    path = tmp_path / "none.bvh"
    path.write_text(re.sub(r"Frames: 1\n(.*\n)[\s\S]*", r"Frames: 0\n\1", one_joint("1 2 3")))
    assert live.main([str(path), "--fast"]) == 1
    assert "expected frames, got none" in capsys.readouterr().err


def test_benchmark_of_streams(monkeypatch, capsys):
    monkeypatch.setattr(benchmark_stream, "FILTERS", {"gaussian": GaussianFilter(1.0)})
    threads = torch.get_num_threads()
    assert benchmark_stream.main(["--frames", "40", "--people", "2"]) == 0
    torch.set_num_threads(threads)
    row = capsys.readouterr().out.splitlines()[1].split()
    assert row[:2] == ["gaussian", "3"] and all(0 < float(ms) < 1000 for ms in row[2:])
