"""A batch that is told to stop, or killed: one line, and nothing runs on."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from _manifest import read_manifest
from archives import contents
from test_archives import COMMAND, GENTLE, run

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")


def children_of(process):
    return Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii").split()


def wait_until(true):
    for _ in range(600):
        if true():
            return
        time.sleep(0.05)
    raise AssertionError("half a minute was not enough")


@pytest.fixture
def at_work(archive, tmp_path):
    """A batch in a group of its own whose two workers, beside a tracker, load torch."""
    command = [*COMMAND, archive, "--output", tmp_path / "out", "--workers", "2", *GENTLE]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    # a shell may have started the tests with interrupts ignored
    heard = partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(command, start_new_session=True, preexec_fn=heard, **pipes) as batch:
        wait_until(lambda: len(children_of(batch.pid)) == 3)
        yield batch


def test_F3_an_interrupt_while_workers_start(at_work, tmp_path):
    os.killpg(at_work.pid, signal.SIGINT)
    said = at_work.communicate()[1].decode()
    assert (at_work.returncode, said[-12:]) == (130, "interrupted\n"), said
    assert "Traceback" not in said, said
    # what has begun is finished, and told of
    assert len(contents(tmp_path / "out")) == len(read_manifest(tmp_path / "out/manifest.jsonl"))


def test_F3_workers_end_with_the_one_that_hands_out(at_work):
    children = children_of(at_work.pid)
    at_work.kill()
    wait_until(lambda: not any(Path(f"/proc/{child}").exists() for child in children))


def test_F3_a_request_to_end_is_an_interrupt(archive, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("_engines.process", lambda *_: signal.raise_signal(signal.SIGTERM))
    before = signal.getsignal(signal.SIGTERM)
    assert run(archive, "--output", tmp_path / "out", *GENTLE) == 130
    assert capsys.readouterr().err.endswith("interrupted\n")
    assert signal.getsignal(signal.SIGTERM) == before
