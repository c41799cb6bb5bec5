"""Who does the work of a batch: workers that die, and the same bytes from all of them."""

import importlib
from collections import deque
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace

import _engines
import pytest
import torch
from _batch import Task
from _cleaning import Outcome
from archives import contents
from test_archives import GENTLE, run


def killing(mark, *, always=False):
    found = ("--filter.class_path", "killing.KillsOnce", "--filter.init_args.mark", mark)
    return (*found, "--filter.init_args.always", str(always).lower())


def killers_output(out):
    """Where the file that kills is written to; as the mark, it is there when its worker dies."""
    place = out / "take 1" / "1.bvh"
    place.parent.mkdir(parents=True)
    return place


@pytest.mark.slow
def test_a_killed_worker_costs_nothing(archive, tmp_path, capsys):
    mark = killers_output(tmp_path / "out")
    assert run(archive, "--output", tmp_path / "out", "--workers", 2, *killing(mark)) == 0
    assert mark.exists() and len(contents(tmp_path / "out")) == 12
    assert capsys.readouterr().out.count("peak speed kept") == 12


def test_a_file_that_kills_its_worker_twice_is_given_up(archive, tmp_path, capsys):
    options = killing(tmp_path / "mark", always=True)
    assert run(archive, "--output", tmp_path / "out", "--workers", 2, *options) == 1
    assert len(contents(tmp_path / "out")) == 11
    said = capsys.readouterr()
    assert (
        f"take 1/1.bvh: {_engines.DEAD}" in said.err and "11 done, 0 skipped, 1 failed" in said.out
    )


class BrokenOnHandingOut(Executor):
    """Its process dies between two files: the first that is handed out after that is refused."""

    def __init__(self, *_):
        self.taken = 0

    def submit(self, fn, /, *arguments, **named):
        self.taken += 1
        if self.taken > 5:
            raise BrokenProcessPool
        future = Future()
        future.set_result(fn(*arguments, **named))
        return future


class BrokenOnceAfterWriting(Executor):
    """Its process dies after the first file is written, before anybody is told."""

    broken = False

    def __init__(self, *_):
        pass

    def submit(self, fn, /, *arguments, **named):
        future = Future()
        outcome = fn(*arguments, **named)
        if BrokenOnceAfterWriting.broken:
            future.set_result(outcome)
        else:
            BrokenOnceAfterWriting.broken = True
            future.set_exception(BrokenProcessPool())
        return future


def test_a_file_that_was_written_by_a_dead_worker_is_done(archive, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_engines, "ProcessPoolExecutor", BrokenOnceAfterWriting)
    monkeypatch.setattr(BrokenOnceAfterWriting, "broken", False)
    finished = tmp_path / "out" / "take 0" / "0.bvh"  # the first: no worker's death remakes it
    finished.parent.mkdir(parents=True)
    finished.touch()
    assert run(archive, "--output", tmp_path / "out", "--workers", 2, *GENTLE) == 0
    assert BrokenOnceAfterWriting.broken
    assert "11 done, 1 skipped, 0 failed" in capsys.readouterr().out
    assert contents(tmp_path / "out")["take 0/0.bvh"] == b""


def test_a_file_that_a_broken_pool_refuses_is_not_lost(archive, cleaned, tmp_path, monkeypatch):
    monkeypatch.setattr(_engines, "ProcessPoolExecutor", BrokenOnHandingOut)
    assert run(archive, "--output", tmp_path / "out", "--workers", 2, *GENTLE) == 0
    assert contents(tmp_path / "out") == cleaned


@pytest.mark.parametrize("workers", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_F6_the_same_bytes(workers, archive, cleaned, tmp_path):
    out = tmp_path / "out"
    assert run(archive, "--output", out, *GENTLE, "--workers", workers) == 0
    assert contents(out) == cleaned


@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_F6_ray_writes_the_same_bytes_though_a_worker_dies(archive, tmp_path, capsys):
    pytest.importorskip("ray", reason="Ray is not installed")
    mark = killers_output(tmp_path / "ray")
    arguments = (archive, *killing(mark), "--workers", 2)
    assert run(*arguments, "--output", tmp_path / "ray", "--engine", "ray") == 0
    assert "12 done, 0 skipped, 0 failed" in capsys.readouterr().out
    assert run(*arguments, "--output", tmp_path / "local") == 0
    assert contents(tmp_path / "ray") == contents(tmp_path / "local")


@pytest.mark.parametrize("deaths", [1, 2])
def test_ray_tries_a_file_again_whatever_its_worker_died_of(deaths, monkeypatch):
    """Ray names what ran out of memory by another kind of error than what was killed."""
    ray = pytest.importorskip("ray", reason="Ray is not installed")
    engine = importlib.import_module("_ray_engine")
    task = Task(Path("a.bvh"), Path("out/a.bvh"), Path("a.bvh"))
    ends = [ray.exceptions.OutOfMemoryError("too much")] * deaths + [Outcome(task, "done", "")]
    tries = []

    def get(reference):
        if isinstance(ends[reference], Exception):
            raise ends[reference]
        return ends[reference]

    def clean(task, again):
        tries.append(again)
        return len(tries) - 1

    actor = SimpleNamespace(clean=SimpleNamespace(remote=clean))
    monkeypatch.setattr(ray, "wait", lambda references: (references, []))
    monkeypatch.setattr(ray, "get", get)
    (outcome,) = engine._handed_out(deque([task]), lambda: actor, 1)
    assert tries == [False, True]
    assert outcome.status == ("done" if deaths == 1 else "failed")


def test_threads_are_put_back(archive, tmp_path):
    before = torch.get_num_threads()
    assert run(archive, "--output", tmp_path / "out", *GENTLE, "--threads", before + 1) == 0
    assert torch.get_num_threads() == before
