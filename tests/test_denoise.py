"""The command line: every outcome is a file and a line, or one line that says what is wrong."""

import os
from pathlib import Path

import _cleaning
import denoise
import numpy as np
import pytest
import torch
from _filter_config import filter_names, in_frames, read_config
from bvh_files import one_joint
from motions import assert_same_rotation, smooth_motion

from torchquat import (
    BilateralFilter,
    ButterworthFilter,
    LiftingDenoiser,
    NonLocalPoseMeans,
    fill_missing,
    gaussian_filter,
    io,
    metrics,
    noise,
)
from torchquat.io import Motion

ROOT = Path(__file__).parents[1]
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
DEMO = ROOT / "examples" / "data" / "sports2d_demo.npz"


@pytest.fixture
def motion(rng):
    """Noisy rotations of two joints at 60 fps, some missing; the third joint never moves."""
    q = smooth_motion(frames=40, joints=3, step=0.05, rng=rng)
    q = noise.gaussian(q, [0.05, 0.05, 0.0], generator=rng)
    q[10:13, 0] = torch.nan
    q[:, 2] = q[0, 2]
    weight = torch.ones(40, 3, dtype=torch.float64)
    weight[20, 1] = 0.0
    return Motion(q, 60.0, ("a", "b", "still"), weight=weight)


@pytest.fixture
def walk(motion, tmp_path):
    (tmp_path / "in").mkdir()
    io.save(motion, tmp_path / "in" / "walk.npz")
    return tmp_path / "in" / "walk.npz"


def run(*arguments) -> int:
    return denoise.main([str(argument) for argument in arguments])


def one_error_line(capsys) -> str:
    """Besides what the noise is estimated to be."""
    captured = capsys.readouterr()
    lines = [x for x in captured.err.splitlines(True) if not x.startswith("noise of ")]
    assert captured.out == "" and len(lines) == 1, captured
    assert lines[0].startswith("error: ")
    return lines[0]


def test_a_file_comes_out_smooth_and_complete(walk, motion, tmp_path, capsys):
    out = tmp_path / "out.npz"
    assert run(walk, "--output", out) == 0
    result = io.load(out)
    before = fill_missing(motion.q, motion.weight)
    assert result.valid.all()
    assert metrics.jitter(result.q) < 0.7 * metrics.jitter(before)
    assert torch.equal(result.q[:, 2], motion.q[:, 2]), "a joint that never moves keeps its bits"
    line = capsys.readouterr().out
    for part in ("40 frames, 4 of 120 joint samples missing (0 whole frames), filled", "jitter"):
        assert part in line
    assert f"{walk} -> {out}: " in line and line.count("\n") == 1


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.stem)
def test_every_config_runs_on_the_demo(config, tmp_path):
    assert run(DEMO, "--output", tmp_path / "out.bvh", "--config", config) == 0
    assert io.load(tmp_path / "out.bvh").q.shape == (230, 12, 4)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (
            "courty2008",
            BilateralFilter(1.0, 0.1, kernel="exponential", iterations=5, boundary="reflect"),
        ),
        ("dean", NonLocalPoseMeans(0.008, patch_radius=5, search_radius=10)),
        ("szczesna2012", LiftingDenoiser("linear", levels=2, rule="finest")),
    ],
)
def test_configs_of_the_papers_have_the_published_values(name, expected):
    config = read_config(ROOT / "configs" / f"{name}.yaml")
    assert repr(config.build(120.0)) == repr(expected)


def test_windows_in_time_become_whole_frames():
    config = read_config(ROOT / "configs" / "nonlocal_means.yaml")
    at_60, at_25 = config.build(60.0), config.build(25.0)
    assert (at_60.patch_radius, at_60.search_radius) == (6, 18)
    assert (at_25.patch_radius, at_25.search_radius) == (2, 8)
    assert at_60.groups == "joint"


def test_every_filter_has_a_config():
    shown = {read_config(path).class_path for path in CONFIGS}
    assert shown == {f"torchquat.{name}" for name in filter_names()}


def test_cut_offs_are_those_of_the_file_whatever_its_frame_rate():
    """A filter with a frame rate gets that of the file; one that is given counts in its own."""
    config = read_config(ROOT / "configs" / "one_euro.yaml")
    at_30, at_120 = config.build(30.0), config.build(120.0)
    assert (at_30.min_cutoff, at_30.d_cutoff, at_30.frame_rate) == (1.0, 1.0, 30.0)
    assert (at_120.min_cutoff, at_120.frame_rate) == (pytest.approx(1.0), 120.0)
    path = ROOT / "configs" / "butterworth.yaml"
    expected = ButterworthFilter(0.1)
    for arguments in ({}, {"cutoff": 6}, {"frame_rate": 1}, {"cutoff": 0.1, "frame_rate": 1}):
        own = read_config(path, init_args=arguments).build(60.0)
        assert own.cutoff / own.frame_rate == pytest.approx(0.1), arguments
        assert own.radius == expected.radius
    with pytest.raises(ValueError, match=r"cutoff must be < frame_rate / 2 = 5, got 6"):
        read_config(path).build(10.0)


@pytest.mark.parametrize(
    ("name", "key", "at_60"),
    [
        ("savitzky_golay", "radius", 6),
        ("median", "radius", 4),
        ("hampel", "radius", 6),
        ("local_spectrum", "window", 64),
    ],
)
def test_windows_of_the_other_filters(name, key, at_60):
    path = ROOT / "configs" / f"{name}.yaml"
    assert getattr(read_config(path).build(60.0), key) == at_60
    half_a_second = read_config(path, init_args={key: "0.5s"}).build(60.0)
    assert getattr(half_a_second, key) == 30


def test_an_unknown_class_is_answered_with_all_filters(walk, tmp_path, capsys):
    arguments = ("--filter.class_path", "Bilateral")
    assert run(walk, "--output", tmp_path / "out.npz", *arguments) == 1
    error = one_error_line(capsys)
    for name in ("BilateralFilter", "LinearFilter", "NonLocalPoseMeans", "LiftingDenoiser"):
        assert name in error
    assert "LiftingTransform" not in error and "HaarPredict" not in error


def test_times_are_converted_with_the_frame_rate_of_the_file(walk, motion, tmp_path):
    out = tmp_path / "out.npz"
    arguments = ("--filter.class_path", "GaussianFilter", "--filter.init_args.sigma_t", "25ms")
    assert run(walk, "--output", out, *arguments, "--filter.init_args.radius", "0.05s") == 0
    expected = gaussian_filter(motion.q, motion.weight, sigma_t=1.5, radius=3)
    assert_same_rotation(io.load(out).q[:, :2], expected[:, :2], 1e-7)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("sigma_t", "25ms", 1.5),
        ("sigma_t", "0.1 s", 6.0),
        ("sigma_t", "1e-2s", 0.6),
        ("sigma_t", 2, 2),
        ("sigma_g", "2e-1", 0.2),
        ("cutoff", "6Hz", 0.1),
        ("min_cutoff", "1.5 Hz", 0.025),
        ("d_cutoff", "1e0Hz", 1 / 60),
        ("window", "1s", 60.0),
        ("boundary", "reflect", "reflect"),
    ],
)
def test_units(key, value, expected):
    assert in_frames(key, value, 60.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("key", "value", "wanted"),
    [
        ("sigma_g", "2ms", "without a unit"),
        ("sigma_t", "6Hz", "in ms or s"),
        ("cutoff", "1s", "in Hz"),
    ],
)
def test_units_that_do_not_fit(key, value, wanted):
    with pytest.raises(ValueError, match=f"expected a number {wanted}, got '{value}'"):
        in_frames(key, value, 60.0)


def test_configs_and_overrides(walk, tmp_path, capsys):
    config = tmp_path / "mine.yaml"
    config.write_text(
        "filter: {class_path: torchquat.BilateralFilter, init_args: {sigma_t: 1e-1s}}"
    )
    assert run(walk, "--output", tmp_path / "a.npz", "--config", config) == 0
    override = ("--filter.init_args.sigma_g", "0.001")
    assert run(walk, "--output", tmp_path / "b.npz", "--config", config, *override) == 0
    jitter = [float(metrics.jitter(io.load(tmp_path / f"{name}.npz").q)) for name in "ab"]
    assert jitter[1] > jitter[0], "a narrow sigma_g keeps what is there"
    capsys.readouterr()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "filter: {class_path: torchquat.Nothing}",
            "filter.class_path: expected one of AutoDenoiser",
        ),
        ("filter: {class_path: nowhere.Filter}", "filter.class_path: No module named 'nowhere'"),
        ("filter: {class_path: .torchquat.Filter}", "filter.class_path: expected a name, got"),
        ("filter: {class_path: torch.Tensor}", "filter.class_path: expected one of AutoDenoiser"),
        ("filter: {init_args: {}}", "filter: expected the key 'class_path'"),
        (
            "filter: {class_path: torchquat.GaussianFilter, args: 1}",
            "init_args, got the key 'args'",
        ),
        ("filtre: 1", "expected the key 'filter'"),
        ("filter: {class_path: torchquat.GaussianFilter}\nseed: 1", "filter, got the key 'seed'"),
        ("", "expected the key 'filter'"),
        ("filter: [", "expected YAML"),
        (
            "filter: {class_path: torchquat.GaussianFilter, init_args: {sigma: 1}}",
            "filter.init_args.sigma: expected one of sigma_t, radius, boundary, causal, learnable",
        ),
        (
            "filter: {class_path: torchquat.GaussianFilter, init_args: {sigma_t: -1}}",
            "torchquat.GaussianFilter: sigma_t must be finite and > 0, got -1",
        ),
        ("!!python/object/apply:os.mkdir [exploded]", "expected YAML"),
    ],
)
def test_E11_wrong_configs_name_file_key_and_valid_keys(
    text, message, walk, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "mine.yaml"
    config.write_text(text)
    assert run(walk, "--output", tmp_path / "out.npz", "--config", config) == 1
    line = one_error_line(capsys)
    assert str(config) in line and message in line
    assert not (tmp_path / "out.npz").exists() and not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("{walk}", "--output", "x.npz", "--workers", "two"), "workers"),
        (("{walk}", "--output", "x.npz", "--turbo"), "turbo"),
    ],
)
def test_wrong_arguments_are_one_line(arguments, message, walk, capsys):
    assert run(*(argument.format(walk=walk) for argument in arguments)) == 2
    assert message in one_error_line(capsys)


@pytest.mark.parametrize("arguments", [(), ("{walk}",), ("--output", "x.npz")])
def test_what_is_needed_is_said(arguments, walk, capsys):
    assert run(*(argument.format(walk=walk) for argument in arguments)) == 1
    assert "expected INPUT and --output OUT; --help shows how" in one_error_line(capsys)


@pytest.mark.parametrize("name", ["workers", "threads"])
def test_workers_and_threads_must_be_positive(name, walk, tmp_path, capsys):
    assert run(walk, "--output", tmp_path / "x.npz", f"--{name}", 0) == 1
    assert f"{name} must be >= 1, got 0" in one_error_line(capsys)


@pytest.mark.parametrize("name", ["nowhere.bvh", "nowhere", "empty", "empty/*.bvh", "notes.txt"])
def test_F2_inputs_that_are_not_there(name, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("hello")
    assert run(tmp_path / name, "--output", tmp_path / "out") == 1
    assert str(tmp_path / name) in one_error_line(capsys)
    assert not (tmp_path / "out").exists()


def test_existing_outputs_are_kept_unless_told(walk, tmp_path, capsys):
    out = tmp_path / "out.npz"
    out.write_bytes(b"mine")
    assert run(walk, "--output", out) == 0
    assert out.read_bytes() == b"mine"
    assert "exists, skipped; --overwrite makes it again" in capsys.readouterr().out
    assert run(walk, "--output", out, "--overwrite") == 0
    assert run(walk, "--output", walk, "--overwrite") == 0


@pytest.fixture
def folder(tmp_path):
    """Two good files, one of them below, and a bad one."""
    (tmp_path / "in" / "deep er").mkdir(parents=True)
    rows = np.random.default_rng(0).normal(0, 5, (20, 3)).tolist()
    (tmp_path / "in" / "a.bvh").write_text(one_joint(*rows))
    (tmp_path / "in" / "deep er" / "b\u00fc.BVH").write_text(one_joint(*rows))
    (tmp_path / "in" / "bad.bvh").write_text(one_joint("1 2 x"))
    (tmp_path / "in" / "notes.txt").write_text("no motion")
    return tmp_path / "in"


def test_F1_F4_one_bad_file_among_many(folder, tmp_path, capsys):
    assert run(folder, "--output", tmp_path / "out") == 1
    found = sorted(p.relative_to(tmp_path / "out") for p in (tmp_path / "out").rglob("*.[bB]*"))
    assert found == [Path("a.bvh"), Path("deep er/b\u00fc.BVH")]
    captured = capsys.readouterr()
    assert captured.out.count("20 frames") == 2
    assert "bad.bvh:10:5: expected a number, got 'x'" in captured.err
    assert captured.err.endswith("error: 1 of 3 files failed\n")


def test_globs_and_several_inputs(folder, tmp_path, capsys):
    assert run(f"{folder}/**/*.[bB]*", folder / "a.bvh", "--output", tmp_path / "out") == 1
    assert (tmp_path / "out" / "a.bvh").exists()
    assert (tmp_path / "out" / "deep er" / "b\u00fc.BVH").exists()
    assert "1 of 3 files failed" in capsys.readouterr().err


def test_F5_two_inputs_for_one_output(folder, tmp_path, capsys):
    (folder / "deep er" / "a.bvh").write_text(one_joint("1 2 3"))
    inputs = (folder / "a.bvh", folder / "deep er" / "a.bvh")
    assert run(*inputs, "--output", tmp_path / "out") == 1
    line = one_error_line(capsys)
    assert "would both go there" in line and all(str(each) in line for each in inputs)
    assert not (tmp_path / "out").exists()


def test_results_inside_the_input_folder_are_no_inputs(folder, capsys):
    (folder / "bad.bvh").unlink()
    assert run(folder, "--output", folder / "clean") == 0
    assert run(folder, "--output", folder / "clean", "--overwrite") == 0
    assert capsys.readouterr().out.count("peak speed kept") == 4


def test_a_file_where_a_folder_is_needed(folder, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    assert run(folder, "--output", tmp_path / "out") == 1
    assert "expected a folder" in one_error_line(capsys)


def test_F3_an_interrupt_leaves_nothing_half_written(walk, tmp_path, capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    assert run(walk, "--output", tmp_path / "out.npz") == 130
    assert capsys.readouterr().err.endswith("interrupted\n")
    assert not [p for p in tmp_path.iterdir() if p.name != "in"]


def test_a_surprise_is_one_line_and_the_batch_goes_on(folder, tmp_path, capsys, monkeypatch):
    def broken(motion, config, device):
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr(_cleaning, "denoise", broken)
    assert run(folder, "--output", tmp_path / "out") == 1
    err = capsys.readouterr().err
    assert err.count("RuntimeError: first line second line") == 2 and "3 of 3 files failed" in err
