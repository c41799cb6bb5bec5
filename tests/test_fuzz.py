"""Two thousand broken files; ``tests/fuzz_readers.py`` tries as many as one likes."""

import random
import sys
import time
from pathlib import Path

import fuzz_readers
import pytest
from fuzzing import generators
from hostile_files import HOSTILE

from torchquat.io import _zip

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits memory by Linux's means")


def test_2000_broken_files_end_in_a_result_or_the_documented_error():
    pytest.importorskip("joblib", reason="joblib is not installed (extra: estimators)")
    counts, failures = fuzz_readers.run(2000, seed=10**6)
    assert failures == []
    kinds = set(generators(ROOT))
    assert {kind for kind, what in counts if what == "refused"} == kinds
    rarely = {"npz, bytes"}  # checksums refuse nearly all
    assert {kind for kind, what in counts if what == "read"} | rarely == kinds


def test_the_same_seed_makes_the_same_files():
    for name, (_, make) in generators(ROOT).items():
        if not name.startswith(("pt", "pkl")):  # archives of theirs hold addresses
            assert make(random.Random(3)) == make(random.Random(3)), name


@pytest.mark.parametrize("what", HOSTILE)
def test_D18_E1_E2_E3_E11_hostile_files_are_refused(what, tmp_path, monkeypatch):
    """Within two seconds and ten times their size of memory; nothing in them is executed."""
    monkeypatch.setattr(_zip, "MAX_BYTES", 2**28)  # of 4 GiB: a larger bomb takes long to make
    ending, make = HOSTILE[what]
    path = tmp_path / f"case{ending}"
    path.write_bytes(make())
    assert fuzz_readers.outcome(path) == "refused"


def test_a_window_of_seconds_is_read_as_any_other(tmp_path):
    """Each frame of it at each of its places would be five million numbers."""
    path = tmp_path / "case.yaml"
    path.write_text(
        "filter:\n  class_path: torchquat.SavitzkyGolayFilter\n"
        "  init_args: {radius: 1100ms, order: 2}\n"
    )
    assert fuzz_readers.outcome(path) == "read"


@pytest.mark.slow
def test_D18_a_line_of_a_gigabyte(tmp_path, monkeypatch):
    path = tmp_path / "case.bvh"
    with path.open("wb") as file:
        for part in (b"HIERARCHY ", *([b"x" * 2**20] * 2**10)):
            file.write(part)
    monkeypatch.setattr(fuzz_readers, "SECONDS", 60.0)
    monkeypatch.setattr(fuzz_readers, "TIMES", 4)
    assert fuzz_readers.outcome(path) == "refused"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda path: (_ for _ in ()).throw(KeyError("x")), "KeyError"),
        (lambda path: bytearray(2**30), "MemoryError"),
        (lambda path: next(iter(int, 1) and (x for x in iter(int, 1) if x)), "took more than"),
        (lambda path: time.sleep(60.0), "took more than"),
    ],
)
def test_what_is_wrong_is_noticed(wrong, said, tmp_path, monkeypatch):
    """Another error, too much memory, too much time."""
    (tmp_path / "case.bvh").write_bytes(b"")
    monkeypatch.setattr(fuzz_readers, "read", wrong)
    monkeypatch.setattr(fuzz_readers, "SECONDS", 0.2)
    assert said in fuzz_readers.outcome(tmp_path / "case.bvh")
