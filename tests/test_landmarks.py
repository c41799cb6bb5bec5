"""Landmarks as rotations: bones point where they were seen, gaps stay gaps."""

from pathlib import Path

import landmarks_to_bvh as landmarks
import numpy as np
import pytest
import torch
from motions import angle_between, assert_same_rotation

from torchquat import fill_missing, io, so3

ROOT = Path(__file__).parents[1]
TO_Y_UP = torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64)


def person(frames=1):
    """A T-pose facing the camera, in MediaPipe's axes (x right, y down, z away), seen surely."""
    points = torch.zeros(33, 4, dtype=torch.float64)
    points[:, 3] = 1.0
    for index, name in ((11, "shoulder"), (13, "elbow"), (15, "wrist")):
        x = {"shoulder": 0.2, "elbow": 0.5, "wrist": 0.8}[name]
        points[index, :2], points[index + 1, :2] = torch.tensor([[x, -0.5], [-x, -0.5]])
    for index, y in ((23, 0.0), (25, 0.4), (27, 0.8)):
        points[index, :2], points[index + 1, :2] = torch.tensor([[0.1, y], [-0.1, y]])
    points[7, :2], points[8, :2] = torch.tensor([[0.08, -0.7], [-0.08, -0.7]])
    return points.expand(frames, 33, 4).clone()


def rough_person(rng, frames=30):
    """The T-pose with every landmark moved by some centimetres in each frame."""
    points = person(frames)
    points[..., :3] += 0.08 * torch.randn(frames, 33, 3, generator=rng, dtype=torch.float64)
    return points


def directions(points, start, end):
    v = (points[:, end, :3] - points[:, start, :3]) * TO_Y_UP
    return v / v.norm(dim=-1, keepdim=True)


def test_a_t_pose_is_the_rest_pose():
    motion = landmarks.motion_from_landmarks(person(), 30.0)
    assert_same_rotation(motion.q, torch.tensor([0.0, 0, 0, 1]).double().expand(1, 12, 4), 1e-7)
    assert motion.skeleton.offsets[0].tolist() == pytest.approx([0.0, 0.8, 0.0])


def test_forward_kinematics_puts_every_bone_where_it_was_seen(rng):
    points = rough_person(rng)
    motion = landmarks.motion_from_landmarks(points, 30.0)
    rotations, positions = motion.skeleton.forward_kinematics(motion.q)
    tips = motion.skeleton.tips(rotations, positions)
    at = {name: positions[:, joint] for joint, name in enumerate(motion.names)}
    at |= dict(zip(("head", "lw", "rw", "la", "ra"), tips.unbind(1), strict=True))
    for start, end, first, last in (
        ("LeftArm", "LeftForeArm", 11, 13),
        ("LeftForeArm", "lw", 13, 15),
        ("RightArm", "RightForeArm", 12, 14),
        ("RightForeArm", "rw", 14, 16),
        ("LeftUpLeg", "LeftLeg", 23, 25),
        ("LeftLeg", "la", 25, 27),
        ("RightUpLeg", "RightLeg", 24, 26),
        ("RightLeg", "ra", 26, 28),
        ("RightArm", "LeftArm", 12, 11),
        ("RightUpLeg", "LeftUpLeg", 24, 23),
    ):
        bone = at[end] - at[start]
        bone = bone / bone.norm(dim=-1, keepdim=True)
        assert (bone - directions(points, first, last)).norm(dim=-1).max() < 1e-6, (start, end)


def test_an_elbow_bends_about_the_normal_of_its_plane():
    """Left forearm forward by 90 degrees from the T-pose: about -y, and no twist above."""
    points = person()
    points[0, 15, :3] = torch.tensor([0.5, -0.5, -0.3]).double()  # towards the camera
    motion = landmarks.motion_from_landmarks(points, 30.0)
    arm, forearm = (motion.q[0, j] for j in motion.skeleton.index(["LeftArm", "LeftForeArm"]))
    assert_same_rotation(arm, torch.tensor([0.0, 0, 0, 1]).double(), 1e-7)
    expected = torch.tensor([0.0, -np.pi / 2, 0.0], dtype=torch.float64)
    assert torch.allclose(so3.log(forearm), expected, atol=1e-6)


def test_the_plane_of_a_bent_arm_gives_its_twist():
    """The same forearm upward: the upper arm turns about its own axis, the elbow stays a hinge."""
    points = person()
    points[0, 15, :3] = torch.tensor([0.5, -0.8, 0.0]).double()
    motion = landmarks.motion_from_landmarks(points, 30.0)
    arm, forearm = (motion.q[0, j] for j in motion.skeleton.index(["LeftArm", "LeftForeArm"]))
    assert torch.allclose(so3.log(arm), torch.tensor([-np.pi / 2, 0, 0]).double(), atol=1e-6)
    assert torch.allclose(so3.log(forearm), torch.tensor([0, -np.pi / 2, 0]).double(), atol=1e-6)


def test_a_straight_arm_does_not_spin_with_the_noise(rng):
    """Its plane is noise; the twist follows the parent instead."""
    points = person(50)
    points[:, :, :3] += 0.002 * torch.randn(50, 33, 3, generator=rng, dtype=torch.float64)
    motion = landmarks.motion_from_landmarks(points, 30.0)
    arm = motion.q[:, motion.skeleton.index(["LeftArm", "RightArm", "LeftUpLeg"])]
    assert angle_between(arm[1:], arm[:-1]).max() < 0.1


def test_turning_the_whole_person_turns_the_hips_alone(rng):
    points = rough_person(rng)
    turn = so3.exp(torch.tensor([0.3, -0.8, 0.5], dtype=torch.float64))
    moved = points.clone()
    moved[..., :3] = so3.rotate(turn, points[..., :3])
    before = landmarks.motion_from_landmarks(points, 30.0).q
    after = landmarks.motion_from_landmarks(moved, 30.0).q
    assert_same_rotation(after[:, 1:], before[:, 1:], 1e-6)
    assert angle_between(after[:, 0], before[:, 0]).min() > 0.5


def test_gaps_and_doubt(rng):
    points = rough_person(rng)
    points[4] = torch.nan
    points[7, 15, 3] = 0.2  # the left wrist
    motion = landmarks.motion_from_landmarks(points, 30.0)
    assert not motion.valid[4].any() and motion.q[4].isnan().all()
    arm, other = motion.skeleton.index(["LeftForeArm", "RightForeArm"])
    assert motion.weight[7, arm] == 0.2 and motion.weight[7, other] == 1.0
    strict = landmarks.motion_from_landmarks(points, 30.0, min_visibility=0.5)
    assert not strict.valid[7, arm] and strict.valid[7, other]


def test_the_shipped_example_is_what_the_script_makes(shared_data):
    with np.load(shared_data / "estimates" / "mediapipe" / "mediapipe_sports2d_demo.npz") as file:
        points, frame_rate = torch.from_numpy(file["world_raw"]), float(file["fps"])
    made = landmarks.motion_from_landmarks(points, frame_rate)
    shipped = io.load(ROOT / "examples" / "data" / "sports2d_demo.npz")
    assert torch.equal(made.valid, shipped.valid) and made.names == shipped.names
    filled = [fill_missing(each.q, each.weight) for each in (made, shipped)]
    assert_same_rotation(*filled, 1e-6)


def test_the_shipped_example_has_gaps():
    motion = io.load(ROOT / "examples" / "data" / "sports2d_demo.npz")
    gone = (~motion.valid).all(-1).nonzero()[:, 0].tolist()
    assert gone == [0, 1, 2, 169, 201, 227, 228, 229] and motion.frame_rate == 30.0


def test_command_line(rng, tmp_path, capsys):
    points = rough_person(rng)
    points[4] = torch.nan
    np.savez(tmp_path / "in.npz", seen=points.numpy(), fps=25.0)
    arguments = [str(tmp_path / "in.npz"), "--key", "seen", "--output"]
    assert landmarks.main([*arguments, str(tmp_path / "out.npz")]) == 0
    assert not io.load(tmp_path / "out.npz").valid[4].any()
    assert landmarks.main([*arguments, str(tmp_path / "out.bvh")]) == 0
    assert io.load(tmp_path / "out.bvh").frame_rate == pytest.approx(25.0)
    lines = capsys.readouterr().out.splitlines()
    assert "1 frames without anybody" in lines[0] and "filled" in lines[1]
    assert landmarks.main([*arguments, str(tmp_path / "out.npz")]) == 1
    assert "exists; --overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"junk", "expected an npz archive"),
        ({"fps": 25.0}, "expected the key 'world_raw', got ['fps']"),
        ({"world_raw": np.ones((3, 17, 4)), "fps": 25.0}, "(T, 33, 4), got (3, 17, 4)"),
        ({"world_raw": np.full((3, 33, 4), np.nan), "fps": 25.0}, "must hold a person"),
        (
            {"world_raw": np.full((3, 33, 4), "1"), "fps": 25.0},
            "world_raw: expected numbers, got <U1",
        ),
        ({"world_raw": np.ones((3, 33, 4)), "fps": [25.0, 25.0]}, "fps: expected one number, got"),
        ({"world_raw": np.ones((3, 33, 4)), "fps": "25"}, "fps: expected numbers, got <U2"),
    ],
)
def test_errors_are_one_line(content, message, tmp_path, capsys):
    path = tmp_path / "in.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.savez(path, **content)
    assert landmarks.main([str(path), "--output", str(tmp_path / "out.npz")]) == 1
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and message in captured.err
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_E4_damaged_archives_are_one_line(save, rng, tmp_path, capsys):
    path = tmp_path / "in.npz"
    save(path, world_raw=rough_person(rng).numpy(), fps=25.0)
    content = bytearray(path.read_bytes())
    content[3000:3050] = b"\xff" * 50
    for spoilt in (content, content[:2000]):
        path.write_bytes(bytes(spoilt))
        assert landmarks.main([str(path), "--output", str(tmp_path / "out.npz")]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "in.npz: expected an npz archive, got " in error


def test_landmarks_of_any_byte_order(rng, tmp_path, capsys):
    points = rough_person(rng).numpy()
    for name, dtype in (("a", "<f8"), ("b", ">f8")):
        np.savez(tmp_path / f"{name}.npz", world_raw=points.astype(dtype), fps=np.array([25]))
        arguments = [str(tmp_path / f"{name}.npz"), "--output", str(tmp_path / f"{name}_out.npz")]
        assert landmarks.main(arguments) == 0
    first, second = (io.load(tmp_path / f"{name}_out.npz") for name in "ab")
    assert torch.equal(first.q, second.q) and first.frame_rate == 25.0
    capsys.readouterr()
