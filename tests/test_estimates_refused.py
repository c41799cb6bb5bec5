"""Estimators' files that are refused: pickles, wrong keys and shapes, spoilt bytes."""

import io as memory
import pickle
import sys

import make_estimates as made
import numpy as np
import pytest
import torch
from estimate_files import Bomb, turned, write

from torchquat import io
from torchquat.io import FormatError


@pytest.mark.parametrize("trust", [False, None, 1])
def test_E11_a_pickle_is_not_run_unless_trusted(folder, trust):
    path = folder / "wham_output.pkl"
    path.write_bytes(pickle.dumps(Bomb()))
    for call in (io.load_estimate, io.load):
        with pytest.raises(FormatError, match=r"wham_output.pkl: expected trust_pickle=True, got"):
            call(path, trust_pickle=trust)
    assert not (folder / "exploded").exists(), "a pickle was run"


@pytest.mark.parametrize("trust", [False, True])
def test_E11_a_pickle_in_a_torch_file_is_never_run(folder, trust):
    buffer = memory.BytesIO()
    torch.save({"smpl_params_global": Bomb()}, buffer)
    for content in (
        buffer.getvalue(),
        pickle.dumps(Bomb(), 2),
        b"",
        b"HIERARCHY",
        buffer.getvalue()[:99],
    ):
        (folder / "hmr4d_results.pt").write_bytes(content)
        with pytest.raises(FormatError, match=r"hmr4d_results.pt: expected a file of torch.save"):
            io.load_estimate(folder / "hmr4d_results.pt", trust_pickle=trust)
        assert not (folder / "exploded").exists(), "a pickle was run"


def test_E11_an_object_array_in_an_npz_is_never_run(folder):
    path = write(folder / "smpl.npz", made.smpl() | {"extra": np.array([Bomb()], dtype=object)})
    with pytest.raises(FormatError, match="Python objects"):
        io.load_estimate(path, trust_pickle=True)
    hidden = made.amass() | {"markers_latent_vids": np.array([Bomb()], dtype=object)}
    path = write(folder / "amass.npz", hidden)
    io.save_estimate(turned(io.load_estimate(path)), folder / "out.npz")
    assert not (folder / "exploded").exists(), "a pickle was run"


def test_without_joblib_the_extra_is_named(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "joblib", None)
    (folder / "wham_output.pkl").write_bytes(pickle.dumps({}))
    with pytest.raises(ImportError, match=r"pip install 'torchquat\[estimators\]'"):
        io.load_estimate(folder / "wham_output.pkl", trust_pickle=True)


def spoiled(make, *path, value):
    """A tree with one leaf replaced, or left out where the value is ``None``."""
    tree = make()
    branch = tree
    for key in path[:-1]:
        branch = branch[
            list(branch)[key] if isinstance(key, int) and isinstance(branch, dict) else key
        ]
    if value is None:
        del branch[path[-1]]
    else:
        branch[path[-1]] = value
    return tree


GLOBAL = "smpl_params_global"


@pytest.mark.parametrize(
    ("name", "tree", "message"),
    [
        ("a.pt", lambda: [1], r"expected the keys \['smpl_params_global'.*got a list"),
        ("a.pt", lambda: {"pred": {}}, r"got the keys \['pred'\]"),
        (
            "a.pt",
            lambda: spoiled(made.gvhmr, GLOBAL, "body_pose", value=None),
            r"smpl_params_global: expected the keys \['global_orient', 'body_pose'\], got the keys",
        ),
        (
            "a.pt",
            lambda: spoiled(made.gvhmr, GLOBAL, "body_pose", value=torch.zeros(12, 64)),
            r"body_pose: expected floats \(12, 63\) or \(12, 69\), got float32 \(12, 64\)",
        ),
        (
            "a.pt",
            lambda: spoiled(made.gvhmr, GLOBAL, "body_pose", value=torch.zeros(11, 63)),
            r"body_pose: expected floats \(12, 63\).*got float32 \(11, 63\)",
        ),
        (
            "a.pt",
            lambda: spoiled(made.gvhmr, GLOBAL, "transl", value=torch.zeros(12, 2)),
            r"smpl_params_global: transl: expected floats \(12, 3\), got float32 \(12, 2\)",
        ),
        ("a.pkl", dict, r"expected a mapping of people or frames, got the keys \[\]"),
        ("a.pkl", lambda: np.zeros(3), "expected a mapping of people or frames, got a ndarray"),
        ("a.pkl", lambda: {"x": {"y": 1}}, r"WHAM.*PHALP.*got the keys \['y'\] in 'x'"),
        (
            "a.pkl",
            lambda: spoiled(made.wham, 0, "pose_world", value=None),
            r"0: expected the keys .*'pose_world'.*got the keys",
        ),
        (
            "a.pkl",
            lambda: spoiled(made.wham, 0, "pose", value=np.zeros((6, 24, 3))),
            r"0: pose: expected floats \(6, 72\), got float64 \(6, 24, 3\)",
        ),
        (
            "a.pkl",
            lambda: spoiled(made.wham, 0, "frame_ids", value=np.array([3, 4, 4, 5, 6, 7])),
            r"0: frame_ids: expected frame numbers that increase, got \[3, 4, 4, 5, 6, 7\]",
        ),
        (
            "a.pkl",
            lambda: spoiled(made.phalp, 0, "smpl", value=[]),
            r"000001.jpg: smpl: expected 1 entries as in 'tid', got 0",
        ),
        (
            "a.pkl",
            lambda: spoiled(made.phalp, 0, "tracked_time", value=None),
            r"000001.jpg: expected the keys \['tid', 'tracked_time', 'smpl'\], got the keys",
        ),
        (
            "a.pkl",
            lambda: spoiled(made.phalp, 0, "smpl", 0, "body_pose", value=np.zeros((23, 3))),
            r"smpl: 0: body_pose: expected floats \(23, 3, 3\), got float64 \(23, 3\)",
        ),
        (
            "a.npz",
            lambda: {"x": np.zeros(3)},
            r"expected the key 'poses', or .*got the keys \['x'\]",
        ),
        (
            "a.npz",
            lambda: made.amass() | {"pose_jaw": np.ones((made.FRAMES, 3))},
            "pose_jaw: expected what 'poses' holds, got other values",
        ),
        ("a.npz", lambda: {"poses": np.zeros((5, 71))}, "poses: expected a width of 3 J, got 71"),
        ("a.npz", lambda: made.smpl() | {"fps": np.array(0)}, "fps: expected frames per second"),
    ],
)
def test_errors_say_what_was_found_and_expected(folder, name, tree, message):
    path = write(folder / name, tree())
    with pytest.raises(FormatError, match=f"{name}: .*{message}" if message else name) as caught:
        io.load_estimate(path, trust_pickle=True)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["hmr4d_results.pt", "smpl.npz"])
def test_spoilt_files_are_refused_in_one_line_or_read(folder, name):
    whole = write(folder / name, made.gvhmr(3) if name.endswith(".pt") else made.smpl(3))
    content, rng = whole.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        spoilt = bytearray(content)
        for place in rng.integers(len(content), size=rng.choice([1, 3, 20])):
            spoilt[place] = rng.integers(256)
        (folder / name).write_bytes(bytes(spoilt[: rng.integers(1, 2 * len(content))]))
        try:
            io.load_estimate(folder / name)
        except FormatError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 100


def test_a_pickle_of_something_else(folder, joblib):
    (folder / "a.pkl").write_bytes(b"not a pickle")
    with pytest.raises(FormatError, match=r"a.pkl: expected a joblib pickle, got"):
        io.load_estimate(folder / "a.pkl", trust_pickle=True)


def test_a_missing_frame_rate_and_wrong_names(folder):
    path = write(folder / "hmr4d_results.pt", made.gvhmr())
    with pytest.raises(ValueError, match=r"expected frame_rate=.*got None: a file of GVHMR"):
        io.load(path, track="smpl_params_global")
    with pytest.raises(ValueError, match=r"track must be one of .'smpl_params_global', .*got None"):
        io.load(path, frame_rate=30)
    estimate = io.load_estimate(path)
    with pytest.raises(ValueError, match="got 'world'"):
        estimate.motion("world")
    with pytest.raises(ValueError, match=r"must have shape \(12, 22, 4\), got \(3, 22, 4\)"):
        estimate.with_rotations({"smpl_params_global": torch.zeros(3, 22, 4)})
    with pytest.raises(ValueError, match=r"must have shape \(12, 3\), got \(12, 2\)"):
        estimate.with_translations({"smpl_params_global": torch.zeros(12, 2)})
    with pytest.raises(ValueError, match="frame_rate must be finite and > 0, got -1"):
        io.load_estimate(path, frame_rate=-1)
    with pytest.raises(FormatError, match=r"ends in \.pt, as the file read"):
        io.save_estimate(estimate, folder / "out.pkl")
    with pytest.raises(FormatError, match=r"ends in \.pt, \.pkl, \.npz"):
        io.load_estimate(folder / "a.pth")
    bvh_motion = io.load(write(folder / "amass.npz", made.amass()))
    with pytest.raises(ValueError, match="only a motion of such a file"):
        io.save(bvh_motion, folder / "out.pt")
    assert not (folder / "out.pt").exists()
