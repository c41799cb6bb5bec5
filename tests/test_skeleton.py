"""Forward kinematics against 4 x 4 matrices."""

import numpy as np
import pytest
import torch
from motions import numpy_of, random_rotations
from scipy.spatial.transform import Rotation

from torchquat import Skeleton

NAMES, PARENTS = ("hips", "chest", "arm", "leg"), (-1, 0, 1, 0)
OFFSETS = torch.tensor([[9.0, 9, 9], [0, 2, 0], [1, 0, 0.5], [0, -3, 0]]).double()
TIP = (0.1, 0.7, 0.0)  # no numbers of single precision


def by_matrices(q, root):
    """World matrices ``(T, J, 4, 4)``, one joint and frame at a time."""
    world = np.zeros((*q.shape[:2], 4, 4))
    for t in range(len(q)):
        for joint, parent in enumerate(PARENTS):
            local = np.eye(4)
            local[:3, :3] = Rotation.from_quat(q[t, joint]).as_matrix()
            local[:3, 3] = root[t] if parent < 0 else OFFSETS[joint]
            world[t, joint] = local if parent < 0 else world[t, parent] @ local
    return world


def test_agrees_with_matrices(rng):
    skeleton = Skeleton(NAMES, PARENTS, OFFSETS, ((2, TIP),))
    q, root = random_rotations(5, 4, rng=rng), torch.randn(5, 3, generator=rng).double()
    world = by_matrices(numpy_of(q), numpy_of(root))
    rotations, positions = skeleton.forward_kinematics(3.0 * q, root)
    assert np.allclose(positions, world[..., :3, 3])
    matrices = Rotation.from_quat(rotations.reshape(-1, 4).numpy()).as_matrix()
    assert np.allclose(matrices.reshape(5, 4, 3, 3), world[..., :3, :3])
    tips = skeleton.tips(rotations, positions)
    assert np.allclose(tips[:, 0], (world[:, 2] @ np.append(TIP, 1.0))[:, :3], atol=1e-12)


def test_batches_and_gradients(rng):
    skeleton = Skeleton(NAMES, PARENTS, OFFSETS)
    q = random_rotations(2, 3, 4, rng=rng).requires_grad_()
    _, positions = skeleton.forward_kinematics(q)
    assert positions.shape == (2, 3, 4, 3)
    assert torch.equal(positions[:, :, 0], OFFSETS[0].expand(2, 3, 3))
    assert torch.autograd.gradcheck(lambda q: skeleton.forward_kinematics(q)[1], (q,))


def test_only_the_first_joint_is_moved_by_the_root(rng):
    offsets = torch.tensor([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]]).double()
    two = Skeleton(("a", "b", "c"), (-1, -1, 1), offsets)
    q = random_rotations(5, 3, rng=rng)
    root = torch.rand(5, 3, generator=rng, dtype=torch.float64)
    _, places = two.forward_kinematics(q, root)
    assert torch.equal(places[:, 0], root)
    assert torch.equal(places[:, 1], offsets[1].expand(5, 3))


def test_B1_no_joints():
    none = Skeleton((), (), torch.zeros(0, 3).double())
    rotations, places = none.forward_kinematics(torch.zeros(5, 0, 4))
    assert rotations.shape == (5, 0, 4) and places.shape == (5, 0, 3)


def test_indices_by_name():
    skeleton = Skeleton(NAMES, PARENTS, OFFSETS)
    assert skeleton.index(["leg", "hips"]) == [3, 0]
    with pytest.raises(ValueError, match=r"joints must be of \['hips', .*got \['tail'\]"):
        skeleton.index(["tail"])


def test_says_what_is_wrong(rng):
    with pytest.raises(ValueError, match="parents must be < their joint, got 2 for 1"):
        Skeleton(NAMES, (-1, 2, 1, 0), OFFSETS)
    with pytest.raises(ValueError, match="must be of one length, got 4, 3"):
        Skeleton(NAMES, (-1, 0, 1), OFFSETS)
    for joint in (-1, 4):
        with pytest.raises(ValueError, match=rf"end_sites must belong .*\[0, 4\), got {joint}"):
            Skeleton(NAMES, PARENTS, OFFSETS, ((joint, TIP),))
    with pytest.raises(ValueError, match="q must have 4 joints, got 3"):
        Skeleton(NAMES, PARENTS, OFFSETS).forward_kinematics(random_rotations(2, 3, rng=rng))
