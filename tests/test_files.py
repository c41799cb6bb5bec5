"""Load and save by file name, and from one format to the other."""

import os

import numpy as np
import pytest
import torch
from bvh_files import ROTATIONS, bvh_text, joint, one_joint
from motions import assert_same_rotation, random_rotations

from torchquat import Skeleton, io
from torchquat.io import Motion


def body(q, **options):
    """A motion of three joints whose order is not that of a BVH file: the leg comes in between."""
    offsets = torch.tensor([[0.0, 9, 0], [0, 2, 0], [0.5, -1, 0], [1, 0, 0]]).double()
    names = ("hips", "chest", "leg", "arm")
    skeleton = Skeleton(names, (-1, 0, 0, 1), offsets, ((2, (0.0, -4.0, 0.0)), (3, (1.0, 0, 0))))
    return Motion(q, 30.0, names, skeleton=skeleton, **options)


@pytest.mark.parametrize("name", ["walk.fbx", "walk", "walk.bvh.gz", "walk.npy"])
def test_other_endings(name, tmp_path, rng):
    for call in (io.load, lambda path: io.save(body(random_rotations(3, 4, rng=rng)), path)):
        with pytest.raises(ValueError, match=r"expected a name that ends in \.bvh or \.npz"):
            call(tmp_path / name)


def test_no_such_file(tmp_path):
    for name in ("walk.bvh", "walk.npz"):
        with pytest.raises(FileNotFoundError):
            io.load(tmp_path / name)


def test_text_paths_and_capitals(tmp_path):
    path = str(tmp_path / "WALK.BVH")
    with open(path, "w") as file:  # noqa: PTH123
        file.write(one_joint("1 2 3"))
    io.save(io.load(path), os.path.join(tmp_path, "Out.Bvh"))  # noqa: PTH118
    assert (tmp_path / "Out.Bvh").read_bytes() == (tmp_path / "WALK.BVH").read_bytes()


def test_npz_keeps_a_whole_motion(tmp_path, rng):
    weight = torch.rand(5, 4, generator=rng).double()
    before = body(
        random_rotations(5, 4, rng=rng), weight=weight, root_position=torch.rand(5, 3).double()
    )
    io.save(before, tmp_path / "walk.npz")
    after = io.load(tmp_path / "walk.npz")
    assert torch.equal(after.q, before.q) and torch.equal(after.weight, weight)
    assert torch.equal(after.root_position, before.root_position)
    assert (after.names, after.frame_rate) == (before.names, before.frame_rate)
    assert after.skeleton.parents == before.skeleton.parents
    assert after.skeleton.end_sites == before.skeleton.end_sites
    assert torch.equal(after.skeleton.offsets, before.skeleton.offsets)


def test_npz_to_bvh_lists_subtrees_in_one_piece(tmp_path, rng):
    before = body(
        random_rotations(5, 4, rng=rng), root_position=torch.rand(5, 3, generator=rng).double()
    )
    io.save(before, tmp_path / "walk.bvh")
    after = io.load(tmp_path / "walk.bvh")
    assert after.names == ("hips", "chest", "arm", "leg")
    assert after.frame_rate == pytest.approx(30.0, rel=1e-6)
    order = before.skeleton.index(after.names)
    assert_same_rotation(after.q, before.q[:, order], 3e-8)
    assert torch.allclose(after.root_position, before.root_position, atol=1e-6)
    assert set(after.skeleton.end_sites) == {(3, (0.0, -4.0, 0.0)), (2, (1.0, 0.0, 0.0))}
    world = before.skeleton.forward_kinematics(before.q, before.root_position)[1]
    again = after.skeleton.forward_kinematics(after.q, after.root_position)[1]
    assert torch.allclose(again, world[:, order], atol=1e-5)


def test_bvh_to_npz_and_back(tmp_path):
    text = bvh_text(
        joint("a", ROTATIONS, joint("b", ROTATIONS)), rows=["1 2 3 4 5 6", "2 3 4 5 6 7"]
    )
    (tmp_path / "walk.bvh").write_text(text)
    before = io.load(tmp_path / "walk.bvh")
    io.save(before, tmp_path / "walk.npz")
    io.save(io.load(tmp_path / "walk.npz"), tmp_path / "again.bvh")
    assert_same_rotation(io.load(tmp_path / "again.bvh").q, before.q, 3e-8)


def test_two_saves_give_equal_bytes(tmp_path, rng):
    motion = body(random_rotations(5, 4, rng=rng))
    for name in ("a.npz", "b.npz"):
        io.save(motion, tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_bvh_needs_a_skeleton(tmp_path, rng):
    motion = Motion(random_rotations(2, 1, rng=rng), 30.0, ("a",))
    with pytest.raises(ValueError, match="motion must have a skeleton to be written as BVH"):
        io.save(motion, tmp_path / "walk.bvh")
    assert not list(tmp_path.iterdir())


def test_a_motion_of_another_length_does_not_fit_its_file(tmp_path, rng):
    (tmp_path / "walk.bvh").write_text(one_joint("1 2 3", "4 5 6"))
    motion = io.load(tmp_path / "walk.bvh")
    with pytest.raises(ValueError, match=r"q must have shape \(2, 1, 4\), got \(1, 1, 4\)"):
        motion.with_rotations(motion.q[:1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frame_rate": 0.0}, "frame_rate must be finite and > 0, got 0.0"),
        ({"frame_rate": np.inf}, "frame_rate must be finite and > 0, got inf"),
        ({"names": ("a",)}, r"q must have shape \(T, 1, 4\), got \(2, 2, 4\)"),
    ],
)
def test_says_what_is_wrong(options, message, rng):
    arguments = {"q": random_rotations(2, 2, rng=rng), "frame_rate": 30.0, "names": ("a", "b")}
    with pytest.raises(ValueError, match=message):
        Motion(**arguments | options)


def test_D24_a_folder_that_cannot_be_written_to(tmp_path, rng):
    with pytest.raises(OSError):
        io.save(body(random_rotations(2, 4, rng=rng)), tmp_path / "none" / "walk.bvh")
