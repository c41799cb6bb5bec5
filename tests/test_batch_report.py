"""What a batch says before it begins: it must not take long to find out."""

from pathlib import Path

import _batch_report
import pytest
from _batch import Task
from _batch_report import noise_line
from _cleaning import Options
from _filter_config import CONFIGS, read_config

CONFIG = read_config(CONFIGS / "gentle.yaml")


@pytest.fixture
def tasks(archive, tmp_path):
    """Twelve files, the first four of which are finished."""
    sources = sorted(path for path in archive.rglob("*") if path.is_file())
    tasks = [Task(path, tmp_path / path.name, Path(path.name)) for path in sources]
    for task in tasks[:4]:
        task.target.touch()
    return tasks


@pytest.fixture
def looked_at(monkeypatch):
    """Which files are read."""
    read, found = _batch_report.read, []
    monkeypatch.setattr(
        _batch_report, "read", lambda path, **more: found.append(path) or read(path, **more)
    )
    return found


def test_finished_files_are_not_looked_at(tasks, looked_at):
    assert "noise of 2 of 12 files" in noise_line(tasks, Options(CONFIG))
    assert looked_at == [tasks[4].source, tasks[8].source]
    looked_at.clear()
    assert "noise of 3 of 12 files" in noise_line(tasks, Options(CONFIG, overwrite=True))
    assert looked_at == [tasks[0].source, tasks[4].source, tasks[8].source]
    looked_at.clear()
    assert noise_line(tasks[:4], Options(CONFIG)) is None and not looked_at


def test_pickles_and_large_files_are_not_looked_at(tasks, looked_at, monkeypatch):
    tasks[4] = tasks[4]._replace(source=tasks[4].source.with_suffix(".pkl"))
    with tasks[8].source.open("ab") as file:
        file.truncate(_batch_report.LARGEST + 1)
    noise_line(tasks, Options(CONFIG, trust_pickle=True))
    assert looked_at == [tasks[5].source, tasks[9].source]


def test_a_file_that_is_gone_is_not_looked_at(tasks, looked_at):
    tasks[4].source.unlink()
    noise_line(tasks, Options(CONFIG))
    assert looked_at == [tasks[5].source, tasks[8].source]


def test_the_only_file_is_looked_at_whatever_it_is(tasks, looked_at):
    assert f"noise of {tasks[0].source}, estimated" in noise_line(tasks[:1], Options(CONFIG))
    assert looked_at == [tasks[0].source]
