"""Estimators' files: what is read of each, against the arrays they hold."""

import make_estimates as made
import numpy as np
import torch
from estimate_files import load, write
from motions import assert_same_rotation
from scipy.spatial.transform import Rotation

from torchquat import io


def quaternions(vectors: np.ndarray) -> torch.Tensor:
    shape = vectors.shape[:-1]
    q = Rotation.from_rotvec(np.asarray(vectors, float).reshape(-1, 3)).as_quat()
    return torch.from_numpy(q).reshape(*shape, 4)


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
