"""Motions that BVH cannot hold: refused, so that whatever was written can be read."""

from dataclasses import replace
from itertools import product

import pytest
import torch
from bvh_files import one_joint
from motions import random_rotations

from torchquat import Skeleton, io, so3
from torchquat.io import Motion

MISSING = "q must hold no missing rotation to be written, got some: fill them"


@pytest.fixture
def motion(rng):
    """Three joints, not from a file; the root moves."""
    offsets = torch.tensor([[1.0, 2, 3], [0, 4, 0], [0.5, 0, 0]]).double()
    skeleton = Skeleton(("hip", "leg", "arm"), (-1, 0, 0), offsets)
    place = torch.randn(6, 3, generator=rng).double()
    return Motion(random_rotations(6, 3, rng=rng), 30.0, skeleton.names, skeleton, place)


@pytest.fixture
def refused(tmp_path):
    """Try to save a motion; nothing may be left."""

    def message(motion, match):
        with pytest.raises(ValueError, match=match):
            io.save(motion, tmp_path / "out.bvh")
        assert not (tmp_path / "out.bvh").exists()

    return message


@pytest.mark.parametrize("value", [torch.nan, torch.inf, 0.0])
def test_A11_A14_A15_rotations_without_a_direction(value, motion, refused):
    q = motion.q.clone()
    q[4, 1] = value
    refused(replace(motion, q=q), MISSING)


def test_a_rotation_of_no_weight(motion, refused):
    """Whatever stands there is nobody's rotation."""
    weight = torch.ones(6, 3, dtype=torch.float64)
    weight[4, 1] = 0.0
    refused(replace(motion, weight=weight), MISSING)


def test_only_joints_that_are_written_anew_need_be_complete(tmp_path, refused):
    (tmp_path / "in.bvh").write_text(one_joint("10 20 30", "11 21 31"))
    before = io.load(tmp_path / "in.bvh")
    gap = torch.tensor([[1.0], [0.0]], dtype=torch.float64)
    turn = so3.exp(torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64))
    refused(replace(before, q=so3.compose(before.q, turn), weight=gap), MISSING)
    io.save(replace(before, weight=gap), tmp_path / "out.bvh")
    assert (tmp_path / "out.bvh").read_bytes() == (tmp_path / "in.bvh").read_bytes()


def test_D16_names_come_back_or_are_refused(motion, tmp_path):
    """All short ones of letters that mean something in a BVH file, and of some that do not."""
    skeleton = motion.skeleton
    path, refused = tmp_path / "out.bvh", set()
    for letters in (
        letters for size in range(4) for letters in product(" \t\r\n{}a:", repeat=size)
    ):
        name = "".join(letters)
        named = replace(skeleton, names=("hip", name, "arm"))
        try:
            io.save(replace(motion, names=named.names, skeleton=named), path)
        except ValueError as error:
            assert str(error).startswith("names must be of one line") and repr(name) in str(error)
            refused.add(name)
            continue
        assert io.load(path).names == ("hip", name, "arm")
    assert {"", " ", "}", "{", "a\n", "\na", "a\ra", " a", "a\t", "a }"} <= refused
    assert not {"a", "a a", "a:a", "a{", "}}", "{a}", "a\ta"} & refused


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_positions_of_the_root_that_are_missing(value, motion, refused):
    place = motion.root_position.clone()
    place[4, 1] = value
    wanted = "root_position must hold no missing position to be written, got some: fill them"
    refused(replace(motion, root_position=place), wanted)
