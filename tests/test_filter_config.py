"""Filters by name and arguments: which file is meant, and values that make no filter."""

from pathlib import Path

import pytest
from _filter_config import CONFIGS, FilterConfig, find_config


@pytest.mark.parametrize("make", [Path.mkdir, Path.touch])
def test_what_lies_around_does_not_hide_a_preset(make, folder):
    make(folder / "gentle")
    assert find_config("gentle") == CONFIGS / "gentle.yaml"


def test_a_config_is_a_file_or_a_preset(folder):
    (folder / "mine.yaml").touch()
    (folder / "configs").mkdir()
    assert find_config("mine.yaml") == Path("mine.yaml")
    for name in ("configs", "nothing", "."):
        with pytest.raises(ValueError, match=f"^{name}: expected a YAML file or one of bilateral,"):
            find_config(name)


@pytest.mark.parametrize(
    ("radius", "frames"),
    [("10ms", 1), ("1e-9 s", 1), ("0.02s", 1), ("50ms", 2), ("0.1s", 3), ("0ms", 0), ("0.4", 0)],
)
def test_a_time_above_0_is_one_frame_at_least(radius, frames):
    """A radius of 10 ms at 30 fps would be none, and the filter would do nothing, silently."""
    config = FilterConfig("torchquat.MedianFilter", {"radius": radius})
    assert config.build(30.0).radius == frames


def test_A23_a_time_below_0_is_none():
    with pytest.raises(ValueError, match="radius must be >= 0, got -"):
        FilterConfig("torchquat.MedianFilter", {"radius": "-30ms"})


@pytest.mark.parametrize("rate", [[1], "fast", None])
def test_A23_cut_offs_need_a_frame_rate_that_is_a_number(rate):
    arguments = {"min_cutoff": "2Hz", "beta": 0.1, "frame_rate": rate}
    with pytest.raises(ValueError, match="min_cutoff: expected a number for frame_rate"):
        FilterConfig("torchquat.OneEuroFilter", arguments)
