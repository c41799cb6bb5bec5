"""The benchmark of quality: that it judges fairly, and that it runs."""

import _quality_clips as clips
import _quality_methods as quality_methods
import _quality_table as quality_table
import benchmark_quality as quality
import numpy as np
import pytest
import torch
from _clips import synthetic_arm
from motions import smooth_motion
from torch import nn

from torchquat import GaussianFilter, fill_missing, io, metrics, noise, so3


def test_figures_are_those_of_the_metrics(rng):
    clean = smooth_motion(rng=rng)
    made = noise.gaussian(clean.expand(2, 3, *clean.shape), 0.1, generator=rng)
    for q, (psnr, kept, change) in zip(made, quality.measured(made, clean), strict=True):
        several = clean.expand(q.shape)
        assert float(psnr) == pytest.approx(float(metrics.psnr(q, several)))
        assert float(kept) == pytest.approx(float(metrics.peak_speed_kept(q, several)))
        assert float(change) == pytest.approx(float(so3.distance(q, several).mean().rad2deg()))
    same = quality.measured(clean.expand(2, 3, *clean.shape), clean)
    assert torch.equal(same, torch.tensor([[torch.inf, 1.0, 0.0]] * 2).double())


def test_oracle_takes_the_best_setting_of_every_column():
    """Two settings, two clips, columns clean, 1 and 5: the mean over the clips decides."""
    psnr = {"weak": [[9, 30, 20], [9, 30, 29]], "strong": [[5, 25, 25], [5, 34, 25]]}
    found = {
        name: np.stack([np.array(values), *[np.full((2, 3), mark)] * 2], -1)
        for mark, (name, values) in enumerate(psnr.items(), start=1)
    }
    row = quality_table.tuned(found, "usual", ["clean", "1", "5"], ["a", "b"])
    assert row.settings == ["strong", "weak", "strong"]  # clean: as for column 5
    assert np.array_equal(row.psnr, [[5, 30, 25], [5, 30, 25]])
    assert np.array_equal(row.kept, [[2, 1, 2]] * 2) and np.array_equal(row.change, row.kept)


def test_draws_depend_on_their_own_names_only():
    clip = clips.Clip("arm", synthetic_arm(40).q)
    both = clips.corrupted(clip, 60, ["impulse", "5"], [0, 3])
    assert both.shape == (2, 2, 40, 3, 4)
    assert torch.equal(clips.corrupted(clip, 60, ["5"], [3])[0, 0], both[1, 1])
    assert not torch.equal(both[1, 0], both[1, 1])


@pytest.mark.parametrize("column", clips.COLUMNS)
def test_every_column_is_as_noisy_as_it_says(column):
    clip = clips.Clip("arm", synthetic_arm(300).q.repeat(1, 20, 1))
    angle = so3.distance(clips.corrupted(clip, 120, [column], [0]), clip.q)
    sizes = {"clean": 0.0, "impulse": 0.5 * 0.05**0.5, "AR(1)": 0.04, "pops": 0.5 * 0.05**0.5}
    expected = sizes.get(column) if not column.isdigit() else 0.008 * int(column)
    size = float((angle.square().mean() / 3.0).sqrt())
    if expected is None:
        assert 0.008 < size < 0.6
    else:
        assert size == pytest.approx(expected, rel=0.2)


def test_wrong_ways_take_batches():
    q = smooth_motion(2, 3, joints=2, rng=torch.Generator().manual_seed(0))
    row = quality_methods.methods()["increments integrated"].settings["sigma_t 1.4"]
    alone = torch.stack([torch.stack([row(one) for one in item]) for item in q])
    assert torch.allclose(row(q), alone, atol=1e-12)


@pytest.fixture
def folder(tmp_path):
    """Two short BVH files, one with a frame that the manifest drops."""
    motion = synthetic_arm(90, 120.0)
    for name in ("first", "second"):
        io.save(motion, tmp_path / f"{name}.bvh")
    (tmp_path / "manifest.csv").write_text("file,drop_first\nsecond.bvh,30\n", encoding="utf-8")
    return tmp_path


def test_slices(folder):
    paths = clips.paths_of(folder)
    whole = fill_missing(io.load(paths[0]).q)
    first, second = clips.read(paths, 120, 20, None)
    assert torch.allclose(first.q, whole[35:55]) and torch.allclose(second.q, whole[50:70])
    first, second = clips.read(paths, 30, 5, 2)
    assert torch.allclose(first.q, whole[8:28:4])
    assert torch.allclose(second.q, whole[38:58:4])
    assert len(clips.read([], 30, 12, None)[0].q) == 12


def test_quick_run_writes_table_and_plot(folder, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["--clips", str(folder), "--output", str(out), "--rates", "120", "--quick"]
    assert quality.main(arguments) == 0
    said = capsys.readouterr().out
    assert said.startswith("120 fps: 2 clips") or said.startswith("skipped: ")
    text = (out / "quality.txt").read_text(encoding="utf-8")
    assert text in said and (out / "quality.png").read_bytes().startswith(b"\x89PNG")
    for name, row in quality_methods.methods().items():
        assert name in (said if row.missing else text)
    assert "best (any)" in text


def test_the_oracle_never_loses_to_one_of_its_settings(folder):
    row = quality_methods.Method("usual", {f"{s}": GaussianFilter(s) for s in (0.5, 1.0, 4.0)})
    known = {
        quality_methods.NOISY: quality_methods.Method("input", {"": nn.Identity()}),
        "one": row,
    }
    cut = clips.read(clips.paths_of(folder), 120, 60, None)
    found = quality.judge(known, cut, 120, ["1", "75"], [0, 1])
    best = quality_table.tuned(found["one"], "usual", ["1", "75"], ["a", "b"])
    for figures in found["one"].values():
        assert (best.psnr.mean(0) >= figures[..., 0].mean(0)).all()
    assert best.settings[0] != best.settings[1]


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--columns", "7"], "columns must be of clean, 1, 5, "),
        (["--methods", "magic"], "methods must be of noisy, "),
        (["--frames", "1"], "frames must be >= 2, got 1"),
        (["--start", "-1"], "start must be >= 0, got -1"),
        (["--start", "500"], "start must be < 90, got 500"),
        (["--rates", "0"], "rates must be >= 1, got 0"),
    ],
)
def test_says_what_is_wrong(folder, extra, message, capsys):
    assert quality.main(["--clips", str(folder), "--output", str(folder), *extra]) == 1
    assert message in capsys.readouterr().err


def test_a_folder_without_clips(tmp_path, capsys):
    assert quality.main(["--clips", str(tmp_path)]) == 1
    assert "clips must be a folder of BVH files, got" in capsys.readouterr().err


def test_noisy_input_is_as_noisy_as_the_design_says(shared_data):
    paths = sorted((shared_data / "cmu").glob("*.bvh"))
    names = ["1", "5", "15", "30", "75", "impulse"]
    rows = {quality_methods.NOISY: quality_methods.methods()[quality_methods.NOISY]}
    cut = clips.read(paths, 120, None, None)
    found = quality.judge(rows, cut, 120, names, [0])[quality_methods.NOISY][""]
    assert np.allclose(found[..., 0].mean(0), [47.1, 33.1, 23.6, 17.6, 9.6, 24.2], atol=0.11)


def test_margins_are_to_the_best_of_each_kind():
    def row(kind, psnr):
        values = np.array([psnr])
        return quality_table.Row(kind, ["1", "5"], ["a"], values, values, values, ["", ""])

    rows = {
        "noisy": row("input", [10.0, 10.0]),
        "bad": row("wrong", [12.0, 30.0]),
        "good": row("usual", [20.0, 21.0]),
        "new": row("ours", [23.0, 22.5]),
    }
    text = [line.split() for line in quality_table.table(rows, "x").splitlines()]
    assert ["best", "(usual)", "20.0", "21.0"] in text and ["1:", "good,", "5:", "good"] in text
    assert ["new", "-", "best", "+3.0", "+1.5"] in text
    assert ["best", "(any)", "20.0", "30.0"] in text and ["1:", "good,", "5:", "bad"] in text
    assert ["new", "-", "best", "+3.0", "-7.5"] in text
