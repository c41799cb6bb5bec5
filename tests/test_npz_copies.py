"""Files that hold parts of a pose twice: both are filtered, whatever the width and the names."""

import numpy as np
import pytest
import torch
from make_estimates import walk, wobble

from torchquat import io, so3

FRAMES = 7
CASES = [
    (72, {"root_orient": (0, 3), "pose_body": (3, 66)}),
    (66, {"root_orient": (0, 3), "pose_body": (3, 66)}),
    (72, {"global_orient": (0, 3), "body_pose": (3, 72)}),
    (156, {"global_orient": (0, 3), "body_pose": (3, 66), "left_hand_pose": (66, 111)}),
    (165, {"root_orient": (0, 3), "body_pose": (3, 66), "jaw_pose": (66, 69)}),
]


def motion_of(path):
    return io.load(path)


def track_of(path):
    return io.load_estimate(path).motion()


def turned(motion):
    turn = so3.exp(torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    return motion.with_rotations(so3.compose(motion.q, turn))


def arrays_of(width, spans):
    poses = wobble(FRAMES, width // 3, 1).reshape(FRAMES, width)
    copies = {key: poses[:, slice(*span)].astype("f4") for key, span in spans.items()}
    return {"poses": poses, "trans": walk(FRAMES, 1), "mocap_framerate": 30.0} | copies


@pytest.mark.parametrize("load", [motion_of, track_of])
@pytest.mark.parametrize(("width", "spans"), CASES)
def test_copies_change_with_the_pose(width, spans, load, tmp_path):
    arrays = arrays_of(width, spans)
    np.savez(tmp_path / "in.npz", **arrays)
    io.save(turned(load(tmp_path / "in.npz")), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        for key, span in spans.items():
            assert file[key].dtype == np.float32 and file[key].shape == arrays[key].shape
            assert np.allclose(file[key], file["poses"][:, slice(*span)], atol=1e-6), key
            assert not np.allclose(file[key], arrays[key], atol=0.01), key


@pytest.mark.parametrize("load", [motion_of, track_of])
def test_a_copy_with_an_axis_of_joints_keeps_it(load, tmp_path):
    arrays = arrays_of(72, {"global_orient": (0, 3), "body_pose": (3, 72)})
    arrays["body_pose"] = arrays["body_pose"].reshape(FRAMES, 23, 3)
    np.savez(tmp_path / "in.npz", **arrays)
    io.save(turned(load(tmp_path / "in.npz")), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        assert file["body_pose"].shape == (FRAMES, 23, 3)
        assert np.allclose(file["body_pose"].reshape(FRAMES, 69), file["poses"][:, 3:], atol=1e-6)


@pytest.mark.parametrize("load", [motion_of, track_of])
@pytest.mark.parametrize(
    "other",
    [
        np.ones((FRAMES, 3)),
        np.ones((FRAMES + 1, 3)),
        np.ones((FRAMES, 96)),
        np.ones(FRAMES),
        np.array(1.0),
        np.array("none"),
        np.zeros((FRAMES, 0)),
    ],
    ids=lambda array: f"{array.dtype.kind}{array.shape}",
)
def test_what_only_has_the_name_is_left_alone(other, load, tmp_path):
    np.savez(tmp_path / "in.npz", **(arrays_of(72, {}) | {"root_orient": other}))
    io.save(turned(load(tmp_path / "in.npz")), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        assert np.array_equal(file["root_orient"], other)
