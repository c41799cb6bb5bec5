"""Fixtures of all tests."""

from pathlib import Path
from types import ModuleType

import pytest
import torch
from archives import contents, write_archive
from filters_under_test import ALL
from torch import nn

torch.set_num_threads(1)  # one process a core runs the suite: more threads only wait for each other

SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.fixture(params=[torch.float64, torch.float32], ids=["f64", "f32"])
def dtype(request: pytest.FixtureRequest) -> torch.dtype:
    return request.param


@pytest.fixture(params=ALL)
def run(request: pytest.FixtureRequest) -> nn.Module:
    """Every filter of the package in turn."""
    return ALL[request.param]


@pytest.fixture
def shared_data() -> Path:
    """Real motion beside the repository; it is not part of it."""
    if not SHARED_DATA.is_dir():
        pytest.skip("../shared/data is absent")
    return SHARED_DATA


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder that is the working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def joblib() -> ModuleType:
    """The module, for tests that need it."""
    return pytest.importorskip("joblib", reason="joblib is not installed (extra: estimators)")


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """A folder of twelve motion files."""
    write_archive(tmp_path / "in", 12)
    return tmp_path / "in"


@pytest.fixture
def cleaned(archive: Path, tmp_path: Path) -> dict[str, bytes]:
    """What an undisturbed run makes of them."""
    # not above: most tests do without what the command line needs
    denoise = pytest.importorskip("denoise", reason="jsonargparse is not installed (extra: cli)")
    out = tmp_path / "undisturbed"
    assert denoise.main([str(archive), "--output", str(out), "--config", "gentle"]) == 0
    return contents(out)
