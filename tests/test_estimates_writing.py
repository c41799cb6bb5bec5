"""Estimators' files written back: nothing but rotations changes, translations on request."""

import collections
import pickle
import zlib
from typing import NamedTuple

import make_estimates as made
import numpy as np
import pytest
import torch
from estimate_files import CASES, changed, load, tree_of, turned, write
from motions import assert_same_rotation
from scipy.spatial.transform import Rotation

from torchquat import BilateralFilter, io
from torchquat.io import FormatError

FILTER = BilateralFilter(1.5, 0.5)


@pytest.fixture(params=CASES)
def case(request, folder):
    """A file of each producer, and its content."""
    name, make, options = CASES[request.param]
    tree = make()
    return write(folder / name, tree, **options), tree


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


@pytest.mark.parametrize("protocol", range(6))
def test_a_plain_pickle_stays_one(protocol, folder, joblib):
    """Whoever wrote it reads it with Python's own module, and may not have joblib."""
    path = folder / "wham_output.pkl"
    path.write_bytes(pickle.dumps(made.wham(), protocol))
    io.save_estimate(turned(load(path)), path)
    after = pickle.loads(path.read_bytes())
    leaves = {leaf[-1] for leaf in changed(made.wham(), after)}
    assert leaves == {"pose", "pose_world"}
    assert path.read_bytes()[:2] == bytes([0x80, protocol]) or protocol < 2


@pytest.mark.parametrize("options", [{}, {"protocol": 2}, {"protocol": 5}, {"compress": 3}])
def test_what_joblib_wrote_stays_its_own(options, folder, joblib):
    """Arrays lie beside the pickle: not all pickled anew, and mapped from the disk by some."""
    path = write(folder / "wham_output.pkl", made.wham(), **options)
    io.save_estimate(turned(load(path)), path)
    content = path.read_bytes() if "compress" not in options else zlib.decompress(path.read_bytes())
    assert b"NumpyArrayWrapper" in content


class Pair(NamedTuple):
    """Two entries, as some programs return them."""

    first: object
    second: object


def test_people_may_be_listed_in_tuples(folder, joblib):
    tree = made.phalp()
    for frame in tree.values():
        for key in ("smpl", "camera", "tid"):
            frame[key] = Pair(*frame[key]) if len(frame[key]) == 2 else tuple(frame[key])
    path = write(folder / "demo_clip.pkl", tree)
    estimate = turned(load(path))
    moved = {name: track.translation + 1.0 for name, track in estimate.tracks.items()}
    io.save_estimate(estimate.with_translations(moved), path)
    after = tree_of(path)
    kinds = [[type(frame[key]) for key in ("smpl", "camera", "tid")] for frame in after.values()]
    assert kinds == [
        [type(frame[key]) for key in ("smpl", "camera", "tid")] for frame in tree.values()
    ]
    assert {Pair, tuple} == {kind for each in kinds for kind in each}
    for name, track in load(path).tracks.items():
        seen = track.weight[:, 0] > 0
        assert_same_rotation(track.q[seen], estimate.tracks[name].q[seen], 2e-6)
