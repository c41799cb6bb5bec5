"""Skeletons in plain npz files: what is none is a FormatError, never a surprise."""

import numpy as np
import pytest

from torchquat import io
from torchquat.io import FormatError

TIP = {"end_site_parents": [2], "end_site_offsets": np.ones((1, 3))}
WHOLE = "expected one dimension of whole numbers, got"


@pytest.fixture
def load(tmp_path):
    def written(**changed):
        arrays = {"q": np.ones((4, 3, 4)), "order": "xyzw", "frame_rate": 30.0}
        arrays |= {"parents": [-1, 0, 1], "offsets": np.ones((3, 3))} | changed
        np.savez(tmp_path / "in.npz", **arrays)
        return io.load(tmp_path / "in.npz")

    return written


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"parents": np.array(-1)}, f"parents: {WHOLE} int64 ()"),
        ({"parents": np.array([[-1], [0], [1]])}, f"parents: {WHOLE} int64 (3, 1)"),
        ({"parents": np.array([-1, 0, np.inf])}, f"parents: {WHOLE} float64 (3,)"),
        ({"parents": np.array([-1, 0, np.nan])}, f"parents: {WHOLE} float64 (3,)"),
        ({"parents": np.array([-1, 0, 0.5])}, f"parents: {WHOLE} float64 (3,)"),
        ({"parents": np.array(["", "a", "b"])}, f"parents: {WHOLE} <U1 (3,)"),
        (TIP | {"end_site_parents": np.array(2)}, f"end_site_parents: {WHOLE} int64 ()"),
        (TIP | {"end_site_parents": np.array([np.inf])}, f"end_site_parents: {WHOLE} float64"),
        (TIP | {"end_site_parents": [99]}, "end_sites must belong to joints in [0, 3), got 99"),
        (TIP | {"end_site_parents": [1, 2]}, "in.npz: "),
        (TIP | {"end_site_offsets": np.ones((1, 2))}, "in.npz: "),
    ],
)
def test_what_is_no_skeleton(changed, message, load):
    with pytest.raises(FormatError) as caught:
        load(**changed)
    assert "in.npz: " in str(caught.value) and message in str(caught.value)


def test_whole_numbers_of_any_kind(load):
    for dtype in (float, ">i2", int):
        skeleton = load(**(TIP | {"parents": np.array([-1, 0, 1], dtype=dtype)})).skeleton
        assert skeleton.parents == (-1, 0, 1)
        assert skeleton.end_sites == ((2, (1.0, 1.0, 1.0)),)
