"""Estimators' files: what is read, what is refused, and that nothing but rotations changes."""

import collections
import io as memory
import pickle
from pathlib import Path
from typing import Any

import make_estimates as made
import numpy as np
import pytest
import torch
from motions import assert_same_rotation
from scipy.spatial.transform import Rotation

from torchquat import BilateralFilter, io, so3
from torchquat.io import FormatError

FILTER = BilateralFilter(1.5, 0.5)
NEEDS_JOBLIB = "joblib is not installed (extra: estimators)"


class Bomb:
    """Unpickled, it would write a file."""

    def __reduce__(self):
        return (open, ("exploded", "w"))


@pytest.fixture
def joblib():
    return pytest.importorskip("joblib", reason=NEEDS_JOBLIB)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: Path, tree: Any, **options: Any) -> Path:
    if path.suffix == ".pt":
        torch.save(tree, path)
    elif path.suffix == ".npz":
        np.savez(path, **tree)
    else:
        pytest.importorskip("joblib", reason=NEEDS_JOBLIB).dump(tree, path, **options)
    return path


def tree_of(path: Path) -> Any:
    """A file as its own program reads it."""
    if path.suffix == ".pt":
        return torch.load(path, weights_only=True)
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {key: file[key] for key in file.files}
    return pytest.importorskip("joblib", reason=NEEDS_JOBLIB).load(path)


def load(path: Path, **options: Any) -> io.Estimate:
    return io.load_estimate(path, **{"frame_rate": 30.0, "trust_pickle": True} | options)


def changed(before: Any, after: Any, path: tuple[Any, ...] = ()) -> set[tuple[Any, ...]]:
    """Paths of the leaves that differ; containers, kinds, dtypes, shapes and order must not."""
    assert type(after) is type(before), path
    if isinstance(before, dict):
        assert list(after) == list(before), path
        pairs = [(key, before[key], after[key]) for key in before]
    elif isinstance(before, list):
        assert len(after) == len(before), path
        pairs = [(i, *pair) for i, pair in enumerate(zip(before, after, strict=True))]
    elif isinstance(before, np.ndarray | torch.Tensor):
        assert before.dtype == after.dtype and before.shape == after.shape, path
        return set() if bool((before == after).all()) else {path}
    else:
        return set() if before == after else {path}
    return {leaf for key, a, b in pairs for leaf in changed(a, b, (*path, key))}


def turned(estimate: io.Estimate) -> io.Estimate:
    turn = so3.exp(torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    return estimate.with_rotations(
        {name: so3.compose(track.q, turn) for name, track in estimate.tracks.items()}
    )


def quaternions(vectors: np.ndarray) -> torch.Tensor:
    shape = vectors.shape[:-1]
    q = Rotation.from_rotvec(np.asarray(vectors, float).reshape(-1, 3)).as_quat()
    return torch.from_numpy(q).reshape(*shape, 4)


CASES = {
    "GVHMR": ("hmr4d_results.pt", made.gvhmr, {}),
    "WHAM": ("wham_output.pkl", made.wham, {}),
    "PHALP": ("demo_clip.pkl", made.phalp, {"compress": 3}),
    "SMPL": ("smpl.npz", made.smpl, {}),
    "AMASS": ("amass.npz", made.amass, {}),
}


@pytest.fixture(params=CASES)
def case(request, folder):
    """A file of each producer, and its content."""
    name, make, options = CASES[request.param]
    tree = make()
    return write(folder / name, tree, **options), tree


def test_gvhmr_has_two_tracks(folder):
    tree = made.gvhmr()
    estimate = load(write(folder / "hmr4d_results.pt", tree))
    assert (estimate.producer, estimate.frame_rate) == ("GVHMR", 30.0)
    assert list(estimate.tracks) == ["smpl_params_global", "smpl_params_incam"]
    for name, track in estimate.tracks.items():
        params = {key: value.numpy() for key, value in tree[name].items()}
        vectors = np.concatenate([params["global_orient"], params["body_pose"]], -1)
        assert_same_rotation(track.q, quaternions(vectors.reshape(made.FRAMES, 22, 3)), 1e-6)
        assert track.names[0] == "pelvis" and track.names[21] == "right_wrist"
        assert np.array_equal(track.translation, params["transl"]) and (track.weight == 1).all()


def test_wham_has_two_tracks_a_person_and_gaps_between_its_frames(folder, joblib):
    tree = made.wham()
    estimate = load(write(folder / "wham_output.pkl", tree))
    assert list(estimate.tracks) == ["0/pose", "0/pose_world", "4/pose", "4/pose_world"]
    track = estimate.tracks["0/pose_world"]  # frames 3, 4, 5, 9, 10, 11
    there = [0, 1, 2, 6, 7, 8]
    assert track.frames.tolist() == list(range(3, 12))
    assert torch.equal(track.weight[:, 0].nonzero()[:, 0], torch.tensor(there))
    assert track.q[3:6].isnan().all() and track.translation[3:6].isnan().all()
    stored = tree[0]["pose_world"].reshape(-1, 24, 3)
    assert_same_rotation(track.q[there], quaternions(stored), 1e-6)
    assert np.array_equal(track.translation[there], tree[0]["trans_world"])
    assert estimate.tracks["4/pose"].frames.tolist() == list(range(8))


def test_phalp_has_one_track_a_person_and_predictions_are_missing(folder, joblib):
    tree = made.phalp()
    estimate = load(write(folder / "demo_clip.pkl", tree, compress=3))
    assert list(estimate.tracks) == ["1", "2"]
    track = estimate.tracks["1"]
    assert track.q.shape == (made.FRAMES, 24, 4) and track.q[4:6].isnan().all()
    assert torch.equal((track.weight == 0).all(-1).nonzero()[:, 0], torch.tensor([4, 5]))
    for t, frame in enumerate(tree.values()):
        if t in (4, 5):
            continue
        smpl = frame["smpl"][frame["tid"].index(1)]
        matrices = np.concatenate([smpl["global_orient"], smpl["body_pose"]])
        assert_same_rotation(
            track.q[t], torch.from_numpy(Rotation.from_matrix(matrices).as_quat()), 1e-6
        )
    assert estimate.tracks["2"].frames.tolist() == list(range(3, made.FRAMES - 2))


def test_smpl_npz_with_one_key_a_part(folder):
    tree = made.smpl()
    estimate = io.load_estimate(write(folder / "smpl.npz", tree))
    assert estimate.frame_rate == 25.0 and list(estimate.tracks) == ["smpl"]
    vectors = np.concatenate([tree["global_orient"], tree["body_pose"]], -1).reshape(-1, 24, 3)
    assert_same_rotation(estimate.track().q, quaternions(vectors), 1e-6)
    assert estimate.track().names[23] == "right_hand"


def test_amass_npz_reads_as_io_load_does(folder):
    path = write(folder / "amass.npz", made.amass())
    estimate, motion = io.load_estimate(path), io.load(path)
    assert_same_rotation(estimate.track("poses").q, motion.q)
    assert estimate.frame_rate == motion.frame_rate


def test_what_is_not_changed_is_written_as_it_was(case):
    path, tree = case
    io.save_estimate(load(path), path.with_stem("out"))
    assert not changed(tree, tree_of(path.with_stem("out")))
    same = load(path)
    same = same.with_rotations({name: track.q.clone() for name, track in same.tracks.items()})
    io.save_estimate(same, path.with_stem("out"))
    assert not changed(tree, tree_of(path.with_stem("out")))


def test_only_rotations_change_and_they_come_back(case):
    path, tree = case
    estimate = turned(load(path))
    io.save_estimate(estimate, path.with_stem("out"))
    leaves = {leaf[-1] for leaf in changed(tree, tree_of(path.with_stem("out")))}
    assert leaves <= {
        *("global_orient", "body_pose", "pose", "pose_world", "poses"),
        *("root_orient", "pose_body", "pose_hand", "pose_jaw", "pose_eye"),
    }
    again = load(path.with_stem("out"))
    for name, track in again.tracks.items():
        seen = track.weight[:, 0] > 0
        assert seen.any()
        assert_same_rotation(track.q[seen], estimate.tracks[name].q[seen], 2e-6)


def test_rotations_without_a_direction_leave_what_is_stored(case):
    path, _ = case
    estimate = turned(load(path))
    broken = {name: track.q.clone() for name, track in estimate.tracks.items()}
    for q in broken.values():
        q[0], q[1] = 0.0, torch.nan
    io.save_estimate(estimate.with_rotations(broken), path.with_stem("out"))
    before, again = load(path), load(path.with_stem("out"))
    for name, track in again.tracks.items():
        assert_same_rotation(track.q[:2], before.tracks[name].q[:2], 2e-6)
        assert_same_rotation(track.q[2], estimate.tracks[name].q[2], 2e-6)


def test_translations_change_on_request_only(case):
    path, tree = case

    def shifted(x: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        assert torch.equal(x.isnan().any(-1), weight == 0)
        return x + 1.0

    io.save_estimate(load(path).filtered(FILTER, translation=shifted), path.with_stem("out"))
    after = tree_of(path.with_stem("out"))
    names = {leaf for leaf in changed(tree, after) if {"transl", "trans", "camera"} & set(leaf)}
    assert names or any("trans_world" in leaf for leaf in changed(tree, after))
    before, again = load(path), load(path.with_stem("out"))
    for name, track in again.tracks.items():
        assert torch.allclose(
            track.translation, before.tracks[name].translation + 1, equal_nan=True, atol=1e-5
        )


def test_filtered_tracks_are_those_of_the_filter(case):
    path, _ = case
    estimate = load(path)
    done = estimate.filtered(FILTER)
    for name, track in estimate.tracks.items():
        assert torch.equal(done.tracks[name].q, FILTER(track.q, track.weight))
        assert (done.tracks[name].weight == 1).all() and (estimate.tracks[name].q is track.q)


def test_E10_rotation_vectors_near_half_turns_are_written_without_jumps(folder, joblib):
    tree = made.wham({0: [*range(20), *range(25, 40)]})
    flips = np.abs(np.diff(tree[0]["pose"], axis=0)).max()
    assert flips > 5  # the root turns by about pi, and its vector flips
    path = write(folder / "wham_output.pkl", tree)
    io.save_estimate(load(path).filtered(FILTER), path)
    pose = tree_of(path)[0]["pose"]
    assert np.abs(np.diff(pose, axis=0)).max() < 1
    assert np.abs(pose[0, :3] - tree[0]["pose"][0, :3]).max() < 0.5  # the branch of the first frame


def test_a_predicted_person_gets_its_own_filled_rotations(folder, joblib):
    """The file has one dictionary for the frame seen last and the frames predicted from it."""
    tree = made.phalp()
    path = write(folder / "demo_clip.pkl", tree, compress=3)
    estimate = load(path).filtered(FILTER)
    io.save_estimate(estimate, path)
    frames = list(tree_of(path).values())
    for t in range(made.FRAMES):
        smpl = frames[t]["smpl"][frames[t]["tid"].index(1)]
        matrices = np.concatenate([smpl["global_orient"], smpl["body_pose"]])
        q = torch.from_numpy(Rotation.from_matrix(matrices).as_quat())
        assert_same_rotation(q, estimate.tracks["1"].q[t], 2e-6)
    assert frames[4]["tracked_time"][0] == 1


def test_containers_and_compression_stay(folder, joblib):
    wham = write(folder / "wham_output.pkl", made.wham())
    phalp = write(folder / "demo_clip.pkl", made.phalp(), compress=3)
    for path in (wham, phalp):
        start = path.read_bytes()[:1]
        io.save_estimate(turned(load(path)), path)
        assert path.read_bytes()[:1] == start
    assert type(tree_of(wham)) is collections.defaultdict and tree_of(wham)[99] == {}
    assert phalp.read_bytes()[:1] == b"\x78"


def test_unknown_content_is_carried_along(folder):
    tree = made.gvhmr() | {"note": "mine", "more": [1, (2.5, None)]}
    tree["smpl_params_global"]["left_hand_pose"] = torch.zeros(made.FRAMES, 12)  # components
    tree["smpl_params_incam"]["right_hand_pose"] = torch.zeros(made.FRAMES, 45)
    path = write(folder / "hmr4d_results.pt", tree)
    estimate = load(path)
    assert estimate.tracks["smpl_params_global"].q.shape[1] == 22
    assert estimate.tracks["smpl_params_incam"].q.shape[1] == 37
    io.save_estimate(turned(estimate), path)
    after = tree_of(path)
    assert after["note"] == "mine" and after["more"] == [1, (2.5, None)]
    assert (after["smpl_params_global"]["left_hand_pose"] == 0).all()


def test_io_load_reads_one_track_and_io_save_writes_the_whole_file(folder):
    tree = made.gvhmr()
    path = write(folder / "hmr4d_results.pt", tree)
    motion = io.load(path, track="smpl_params_incam", frame_rate=30)
    assert motion.frame_rate == 30 and motion.names[1] == "left_hip"
    io.save(motion.with_rotations(FILTER(motion.q)), folder / "out.pt")
    leaves = changed(tree, tree_of(folder / "out.pt"))
    assert leaves == {("smpl_params_incam", key) for key in ("global_orient", "body_pose")}
    io.save(motion, folder / "plain.npz")
    assert_same_rotation(io.load(folder / "plain.npz").q, motion.q)


def test_io_save_of_an_npz_track(folder):
    path = write(folder / "smpl.npz", made.smpl())
    io.save(io.load_estimate(path).motion(), folder / "out.npz")
    assert not changed(made.smpl(), tree_of(folder / "out.npz"))


def test_io_load_of_an_npz_with_one_key_a_part_says_what_reads_it(folder):
    path = write(folder / "smpl.npz", made.smpl())
    with pytest.raises(FormatError, match=r"'body_pose'.*: use io\.load_estimate"):
        io.load(path)


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
    monkeypatch.setitem(__import__("sys").modules, "joblib", None)
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
