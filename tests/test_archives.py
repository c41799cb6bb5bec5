"""A batch run loses no file, whatever happens to it."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import _engines
import denoise
import pytest
import yaml
from _manifest import Manifest, read_manifest
from archives import contents, write_archive
from bvh_files import one_joint

from torchquat import chunks

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, str(ROOT / "examples" / "denoise.py")]
GENTLE = ("--config", "gentle")


def run(*arguments) -> int:
    return denoise.main([str(argument) for argument in arguments])


def test_a_finished_batch_is_left_alone(archive, cleaned, tmp_path, capsys):
    out = tmp_path / "undisturbed"
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.bvh")}
    assert run(archive, "--output", out, *GENTLE) == 0
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.bvh")} == before
    said = capsys.readouterr().out
    assert said.count("exists, skipped; --overwrite makes it again") == 12
    assert "12: 0 done, 12 skipped, 0 failed" in said
    assert run(archive, "--output", out, *GENTLE, "--overwrite") == 0
    assert all(path.stat().st_mtime_ns > then for path, then in before.items())
    assert contents(out) == cleaned


def test_every_file_has_a_line_in_the_manifest(archive, tmp_path):
    (archive / "bad.bvh").write_text("HIERARCHY")
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 1
    records = read_manifest(tmp_path / "out" / "manifest.jsonl")
    assert len(records) == 13
    assert {record["status"] for record in records} == {"done", "failed"}
    (bad,) = (record for record in records if record["status"] == "failed")
    assert bad["input"] == str(archive / "bad.bvh") and "bad.bvh: expected" in bad["error"]
    good = next(record for record in records if record["output"].endswith("1.bvh"))
    assert good["frames"] == 13 and good["error"] is None
    (figures,) = good["figures"]
    assert 0 < figures["jitter_after"] < figures["jitter_before"] and figures["joints"] == 1
    assert set(good["seconds"]) == {"read", "filter", "write", "measure"}


def test_half_a_line_of_a_killed_run_is_ended(tmp_path):
    path = tmp_path / "manifest.jsonl"
    path.write_bytes(b'{"input": "a"}\n{"inp')
    with Manifest(path) as manifest:
        manifest.write({"input": "\u00fc"})
    assert read_manifest(path) == [{"input": "a"}, {"input": "\u00fc"}]
    assert path.read_bytes().count(b"\n") == 3


def wait_for_the_end_of(group):
    """Workers that are still dying count as alive, and keep their temporary files."""
    for _ in range(1000):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.01)


def test_F3_kill_9_in_the_middle_and_start_again(archive, tmp_path):
    write_archive(archive, 60, frames=200)
    out = tmp_path / "out"
    arguments = [str(archive), "--output", str(out), *GENTLE, "--workers", "2"]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    batch = subprocess.Popen([*COMMAND, *arguments], start_new_session=True, **silent)
    while len(contents(out)) < 5:
        assert batch.poll() is None
        time.sleep(0.002)
    os.killpg(batch.pid, signal.SIGKILL)
    batch.wait()
    wait_for_the_end_of(batch.pid)
    finished = contents(out)
    assert 5 <= len(finished) < 60
    (out / f".torchquat-{batch.pid}-{os.uname().nodename}-x.tmp").write_text("half")
    assert run(*arguments) == 0
    assert run(archive, "--output", tmp_path / "undisturbed", *GENTLE) == 0
    assert contents(out) == contents(tmp_path / "undisturbed")
    assert not [path for path in out.rglob("*") if ".torchquat-" in path.name]
    assert finished.items() <= contents(out).items()


def test_shards_are_the_whole(archive, cleaned, tmp_path):
    out = tmp_path / "out"
    for part in ("1/3", "2/3", "3/3"):
        assert run(archive, "--output", out, *GENTLE, "--shard", part) == 0
        name = f"manifest-{part[0]}-of-3.jsonl"
        assert [each["status"] for each in read_manifest(out / name)] == ["done"] * 4
    assert contents(out) == cleaned
    assert run(archive, "--output", out, *GENTLE, "--shard", "13/20") == 0


@pytest.mark.parametrize("part", ["0/3", "4/3", "1", "a/b", "1/0"])
def test_shards_that_are_none(part, archive, tmp_path, capsys):
    assert run(archive, "--output", tmp_path / "out", "--shard", part) == 1
    assert f"shard must be I/N with 1 <= I <= N, got {part!r}" in capsys.readouterr().err


def test_F2_a_full_disk(archive, tmp_path, capsys):
    """A limit on the size of files stands for it: the system refuses to write on."""
    (archive / "long.bvh").write_text(one_joint(*[[1.25, 2.5, 3.75]] * 4000))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        assert run(archive, "--output", tmp_path / "out", *GENTLE) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "long.bvh: " in capsys.readouterr().err
    assert len(contents(tmp_path / "out")) == 12 and not (tmp_path / "out" / "long.bvh").exists()
    assert not [path for path in (tmp_path / "out").rglob("*") if ".torchquat-" in path.name]


def test_F2_a_file_that_may_not_be_read(archive, tmp_path, capsys, monkeypatch):
    load = Path.read_bytes

    def refused(path):
        if path.name == "3.bvh":
            raise PermissionError(13, "Permission denied", str(path))
        return load(path)

    monkeypatch.setattr(Path, "read_bytes", refused)
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 1
    assert f"error: {archive / 'take 3' / '3.bvh'}: Permission denied" in capsys.readouterr().err
    assert len(contents(tmp_path / "out")) == 11


def test_F4_names(tmp_path):
    names = ("a b.bvh", "\u00e4\u6f22\U0001f483.bvh", "n" * 251 + ".bvh", "-x.bvh", "a'\"$.bvh")
    (tmp_path / "in").mkdir()
    for name in names:
        (tmp_path / "in" / name).write_text(one_joint([1, 2, 3]))
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE) == 0
    assert set(contents(tmp_path / "out")) == set(names)


def test_F4_links_do_not_lead_out_of_the_output(archive, tmp_path, capsys):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "take 1").symlink_to(tmp_path / "elsewhere")
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 1
    assert "got a link out of it" in capsys.readouterr().err
    assert not list((tmp_path / "elsewhere").iterdir()) and not contents(tmp_path / "out")


def test_F4_a_link_among_the_inputs_is_read(archive, tmp_path):
    (tmp_path / "far.bvh").write_text(one_joint([1, 2, 3], [2, 3, 4]))
    (archive / "near.bvh").symlink_to(tmp_path / "far.bvh")
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 0
    assert (tmp_path / "out" / "near.bvh").exists()
    assert (tmp_path / "far.bvh").read_text() == one_joint([1, 2, 3], [2, 3, 4])


def test_F3_ctrl_c_keeps_what_is_done(archive, tmp_path, capsys, monkeypatch):
    seen = []

    def interrupted(task, options):
        if len(seen) == 5:
            raise KeyboardInterrupt
        seen.append(task)
        return process(task, options)

    process = _engines.process
    monkeypatch.setattr(_engines, "process", interrupted)
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 130
    said = capsys.readouterr()
    assert "5: 5 done, 0 skipped, 0 failed" in said.out and said.err.endswith("interrupted\n")
    assert len(contents(tmp_path / "out")) == 5
    assert len(read_manifest(tmp_path / "out" / "manifest.jsonl")) == 5


def test_a_dry_run_writes_nothing(archive, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(archive, "--output", out, "--dry-run") == 0
    said = capsys.readouterr()
    assert not out.exists() and "12 files, 0.0 MB: 12 to make" in said.out
    assert "noise of 3 of 12 files, estimated: " in said.err
    assert run(archive, "--output", out, *GENTLE, "--shard", "1/2") == 0
    capsys.readouterr()
    assert run(archive, "--output", out, "--dry-run") == 0
    assert "6 to skip, it exists, 6 to make" in capsys.readouterr().out
    assert run(archive, "--output", out, "--dry-run", "--overwrite") == 0
    assert "6 to make again, 6 to make" in capsys.readouterr().out


def test_a_printed_config_is_one(archive, tmp_path, capsys):
    assert run("--config", "strong", "--filter.init_args.sigma_t", "50ms", "--print_config") == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)["filter"]["init_args"]["sigma_t"] == "50ms"
    (tmp_path / "mine.yaml").write_text(text)
    assert run(archive, "--output", tmp_path / "out", "--config", tmp_path / "mine.yaml") == 0


def test_a_preset_that_is_none_is_answered_with_all(archive, tmp_path, capsys):
    assert run(archive, "--output", tmp_path / "out", "--config", "stong") == 1
    error = capsys.readouterr().err
    assert "stong: expected a YAML file or one of " in error and "gentle" in error


def test_long_clips_in_pieces_are_the_same_bytes(archive, cleaned, tmp_path, monkeypatch):
    sizes = []

    def spy(run, q, weight=None):
        sizes.append(len(q))
        return chunks.in_chunks(run, q, weight, frames=9)

    monkeypatch.setattr("_cleaning.in_chunks", spy)
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 0
    assert contents(tmp_path / "out") == cleaned and len(sizes) == 12


@pytest.mark.slow
def test_two_thousand_files(tmp_path, capsys):
    write_archive(tmp_path / "in", 2000)
    assert run(tmp_path / "in", "--output", tmp_path / "out", *GENTLE, "--workers", 2) == 0
    assert len(contents(tmp_path / "out")) == 2000
    text = (tmp_path / "out" / "manifest.jsonl").read_text()
    assert len({json.loads(line)["output"] for line in text.splitlines()}) == 2000
    assert "2000 done, 0 skipped, 0 failed" in capsys.readouterr().out
