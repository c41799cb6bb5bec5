"""What a batch takes for its inputs: every file once, wherever links lead, and no result."""

import os
import sys

import pytest
from _manifest import read_manifest
from archives import contents
from bvh_files import one_joint
from test_archives import GENTLE, run

MOTION = one_joint([1, 2, 3], [2, 3, 4])


def written(*paths):
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(MOTION)


@pytest.mark.parametrize("given", [".", "*.bvh", "**/*.bvh", "absolute"])
def test_results_are_no_inputs(given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(*(tmp_path / f"{name}.bvh" for name in "abx"))
    given = tmp_path if given == "absolute" else given
    for part in ("1/2", "2/2", "1/1"):  # what one machine has written is there for the next
        assert run(given, "--output", "clean", *GENTLE, "--shard", part) == 0
    assert set(contents(tmp_path / "clean")) == {"a.bvh", "b.bvh", "x.bvh"}


def test_linked_folders_are_read_once(tmp_path):
    written(tmp_path / "far" / "a.bvh", tmp_path / "in" / "b.bvh")
    (tmp_path / "in" / "linked").symlink_to(tmp_path / "far")
    (tmp_path / "far" / "round").symlink_to(tmp_path / "in")
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE) == 0
    assert set(contents(tmp_path / "out")) == {"b.bvh", "linked/a.bvh"}


def test_a_link_that_leads_nowhere_is_named(tmp_path, capsys):
    written(tmp_path / "in" / "a.bvh")
    (tmp_path / "in" / "b.bvh").symlink_to(tmp_path / "gone.bvh")
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE) == 1
    assert f"{tmp_path / 'in' / 'b.bvh'}: No such file" in capsys.readouterr().err
    assert set(contents(tmp_path / "out")) == {"a.bvh"}


def test_a_folder_that_cannot_be_read_is_named(tmp_path, capsys, monkeypatch):
    written(tmp_path / "in" / "a.bvh", tmp_path / "in" / "closed" / "b.bvh")
    listed = os.scandir

    def refused(path):
        if os.fspath(path).endswith("closed"):
            raise PermissionError(13, "Permission denied", path)
        return listed(path)

    monkeypatch.setattr(os, "scandir", refused)
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE) == 1
    assert f"{tmp_path / 'in' / 'closed'}: Permission denied" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_two_inputs_with_one_output_behind_a_link_are_refused(tmp_path, capsys):
    written(tmp_path / "in" / "a" / "1.bvh", tmp_path / "in" / "b" / "1.bvh")
    (tmp_path / "out" / "a").mkdir(parents=True)
    (tmp_path / "out" / "b").symlink_to(tmp_path / "out" / "a")
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE) == 1
    assert "would both go there" in capsys.readouterr().err and not contents(tmp_path / "out")


@pytest.mark.skipif(sys.platform != "linux", reason="names that are no text are Linux's")
def test_F4_a_name_that_is_no_text(tmp_path):
    name = os.fsdecode(b"m\xe4rz.bvh")
    written(*(tmp_path / "in" / each for each in ("a.bvh", name, "z\u2028.bvh")))
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE) == 0
    found = {path.name for path in (tmp_path / "out").glob("*.bvh")}
    assert found == {"a.bvh", name, "z\u2028.bvh"}
    records = read_manifest(tmp_path / "out" / "manifest.jsonl")
    assert {record["output"] for record in records} == {str(tmp_path / "out" / n) for n in found}
