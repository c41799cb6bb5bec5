"""A page that shows what was done to a clip."""

import builtins
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import denoise
import numpy as np
import pytest
import torch
from _clip_plots import looked_at, stretches
from _clip_report import write_report
from browser import opened
from make_estimates import wham
from motions import smooth_motion

from torchquat import Skeleton, gaussian_filter, noise
from torchquat.io import Motion

pytest.importorskip("viser", reason="viser is not installed (extra: view)")

DEMO = Path(__file__).parents[1] / "examples" / "data" / "sports2d_demo.npz"
PLOTS = ["angle.png", "change.png", "jitter.png", "speed.png"]
LOADED = ("file", "data", "blob", "about")
STRIP = slice(100, 600)
"""Rows of the window in which the skeletons are."""
BEFORE, AFTER = (196, 78, 82), (42, 111, 151)


@pytest.fixture
def clip(rng):
    """A stick of three joints, y up, that waves; some samples are missing, one is far off."""
    q = noise.gaussian(smooth_motion(frames=90, joints=3, rng=rng), 0.05, generator=rng)
    clean = gaussian_filter(q, sigma_t=2.0)
    q[40:43, 1] = torch.nan
    q[60, 2] = -q[60, 2].flip(0)
    offsets = torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]).double()
    skeleton = Skeleton(("a", "b", "c"), (-1, 0, 1), offsets, ((2, (0.0, 1.0, 0.0)),))
    return Motion(q, 30.0, ("a", "b", "c"), skeleton), clean


def test_what_a_report_holds(clip, tmp_path):
    before, clean = clip
    written = write_report(before, before.with_rotations(clean), tmp_path / "new", "a <b>")
    assert sorted(path.name for path in written) == [*PLOTS[:2], "index.html", *PLOTS[2:]]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(
        path.name for path in written
    )
    for name in PLOTS:
        assert (tmp_path / "new" / name).read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "new" / "index.html").read_text(encoding="utf-8")
    assert "<h1>a &lt;b&gt;</h1>" in page and page.count("data:image/png;base64,") == 4
    assert "Repaired in frames 40 to 42, 60." in page and "3 of 270 joint samples" in page
    outside = page[: page.index("srcdoc=")] + page[page.index("</iframe>") :]
    assert not re.search(r"(?:src|href)=\"(?!data:)", outside)


def test_a_clip_is_compared_sample_by_sample(clip):
    before, clean = clip
    made = looked_at(before, before.with_rotations(clean))
    assert made.missing.nonzero().tolist() == [[40, 1], [41, 1], [42, 1]]
    assert made.repaired.nonzero().tolist() == [[40, 1], [41, 1], [42, 1], [60, 2]]
    assert stretches(made.repaired.any(1)) == [(40, 43), (60, 61)]
    assert made.change[60, 2] > 20 and made.change[10].max() < 20


def test_without_a_skeleton_there_is_no_player(clip, tmp_path):
    before, clean = clip
    before = Motion(before.q, 30.0, before.names)
    write_report(before, before.with_rotations(clean), tmp_path, "bare")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "has no skeleton" in page and "iframe title" not in page


def test_one_joint_has_no_bones(clip, tmp_path):
    before, clean = clip
    one = Skeleton(("a",), (-1,), torch.zeros(1, 3, dtype=torch.float64))
    before = Motion(before.q[:, :1], 30.0, ("a",), one)
    write_report(before, before.with_rotations(clean[:, :1]), tmp_path, "one")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "has no skeleton that could be drawn" in page


def test_a_root_that_is_missing_for_a_while_hides_nothing(clip, tmp_path, monkeypatch):
    before, clean = clip
    root = torch.zeros(90, 3, dtype=torch.float64)
    root[10:13] = torch.nan
    before, drawn = replace(before, root_position=root), []
    monkeypatch.setattr("_clip_player._recorded", lambda server, *sides: drawn.append(sides) or "")
    write_report(before, before.with_rotations(clean), tmp_path, "gap")
    ((first, second, _, _),) = drawn
    assert first.isfinite().all() and second.isfinite().all()


def test_long_clips_are_thinned(clip, tmp_path):
    before, clean = clip
    long = Motion(before.q.repeat(50, 1, 1), 30.0, before.names, before.skeleton)
    write_report(long, long.with_rotations(clean.repeat(50, 1, 1)), tmp_path, "long")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Every 3th frame is shown." in page and "and 60 more stretches" in page
    assert (tmp_path / "index.html").stat().st_size < 4e6


def test_other_joints_are_refused(clip, tmp_path):
    before, clean = clip
    with pytest.raises(ValueError, match="same joints and frames"):
        write_report(before, Motion(clean[:-1], 30.0, before.names), tmp_path, "x")


def test_viser_is_asked_for_by_name(clip, tmp_path, monkeypatch):
    before, clean = clip
    found = builtins.__import__

    def without(name, *more, **kwargs):
        if name == "viser":
            raise ImportError(name)
        return found(name, *more, **kwargs)

    monkeypatch.delitem(sys.modules, "_clip_player", raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ValueError, match=r"--report needs viser: pip install 'torchquat\[view\]'"):
        write_report(before, before.with_rotations(clean), tmp_path, "x")
    assert not list(tmp_path.iterdir()), "nothing is left half done"


def test_the_command_line_writes_reports(tmp_path, capsys):
    arguments = [str(DEMO), "--output", str(tmp_path / "out"), "--report", str(tmp_path / "seen")]
    assert denoise.main(arguments) == 0
    assert (tmp_path / "seen" / DEMO.name / "index.html").exists()
    capsys.readouterr()


def test_whatever_is_wrong_with_a_report_the_file_is_cleaned(tmp_path, capsys, monkeypatch):
    def broken(*_):
        raise IndexError("amax():\nno axis")

    monkeypatch.setattr("_clip_report.write_report", broken)
    out = tmp_path / "out.npz"
    assert denoise.main([str(DEMO), "--output", str(out), "--report", str(tmp_path / "seen")]) == 1
    said = capsys.readouterr().err
    assert f"error: {DEMO}: cleaned, but no report: IndexError: amax(): no axis\n" in said
    assert out.exists()


def test_names_of_people_stay_in_the_folder_of_reports(joblib, tmp_path, capsys, monkeypatch):
    places = []
    monkeypatch.setattr(
        "_clip_report.write_report", lambda before, after, place, title: places.append(place)
    )
    first, second = wham().values()
    people = {"../../x": first, f"{tmp_path}/abs": first, "C:\\x": first, "": first, 7: second}
    joblib.dump(people, tmp_path / "in.pkl")
    arguments = [str(tmp_path / "in.pkl"), "--output", str(tmp_path / "out.pkl")]
    arguments += ["--trust_pickle", "true", "--report", str(tmp_path / "seen")]
    assert denoise.main([*arguments, "--config", "gentle"]) == 0
    folder = tmp_path / "seen" / "out.pkl"
    assert len(set(places)) == len(places) == 10
    for place in places:
        assert place.resolve().is_relative_to(folder), place
    assert folder / "7" / "pose" in places
    assert {folder / "_" / "_" / "x" / "pose", folder / "C_" / "x" / "pose"} <= set(places)
    capsys.readouterr()


def pixels(picture, color):
    """How many are of a colour, about."""
    return int((np.abs(picture.astype(int) - color).max(-1) < 40).sum())


def until(page, reached):
    """Pictures until one is as wanted."""
    end = time.monotonic() + 30
    while True:
        picture = page.picture()
        if reached(picture):
            return picture
        assert time.monotonic() < end, "not drawn in time"


def test_both_skeletons_move_in_a_real_browser(clip, tmp_path):
    before, clean = clip
    write_report(before, before.with_rotations(clean), tmp_path / "page", "stick")
    with opened(tmp_path / "page" / "index.html", tmp_path / "profile") as page:
        middle = 500  # of the window
        until(
            page,
            lambda seen: (
                pixels(seen[STRIP, :middle], BEFORE) > 300
                and pixels(seen[STRIP, middle:], AFTER) > 300
            ),
        )
        page.click(40, 640)  # pause
        places = []
        for x in (300, 700, 700):
            page.click(x, 640)  # the time bar
            time.sleep(0.5)
            places.append(page.picture()[STRIP])
        assert np.all(places[1] == places[2]), "it stands still"
        assert np.any(places[0] != places[1]), "the time bar moves both"
        for half in (slice(0, middle), slice(middle, None)):
            assert (np.abs(places[0][:, half].astype(int) - places[1][:, half]) > 60).sum() > 100
        assert page.complaints() == []
        assert all(
            url.split(":")[0] in ("file", "data", "blob", "about") for url in page.asked_for()
        )
