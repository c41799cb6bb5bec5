"""BVH files written: nothing but rotations changes, and they come back within the decimals."""

import locale
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pybvh
import pytest
import torch
from bvh_files import (
    IRREGULAR,
    ORDERS,
    POSITIONS,
    ROTATIONS,
    bvh_text,
    euler_quaternion,
    joint,
    motion_rows,
    one_joint,
    quaternion_matrix,
    rotation_channels,
)
from motions import assert_same_rotation, numpy_of, random_rotations
from pymotion.io.bvh import BVH

from torchquat import Skeleton, io, so3

SHARED = Path(__file__).parents[2] / "shared" / "data"
REAL = sorted([*SHARED.glob("bvh/*.bvh"), *SHARED.glob("cmu/*.bvh")])
DECIMALS = 3e-8
"""Angle [rad] that rounding three angles to six decimals may cost."""

real_files = pytest.mark.parametrize("path", REAL or [None], ids=lambda p: p.stem if p else "none")


def needs(path):
    if path is None:
        pytest.skip("../shared/data is absent")


def turned(motion, angle=0.3):
    """Every rotation turned by the same angle in its body frame."""
    turn = so3.exp(torch.tensor([angle, -0.5 * angle, 0.2 * angle], dtype=torch.float64))
    return motion.with_rotations(so3.compose(motion.q, turn))


def header_of(content: bytes) -> bytes:
    return content[: content.lower().index(b"frame time")]


@pytest.fixture
def load(tmp_path):
    def from_text(content: str | bytes):
        path = tmp_path / "walk.bvh"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return io.load(path)

    return from_text


@pytest.fixture
def written(tmp_path):
    """Save a motion; returns the bytes."""

    def save(motion) -> bytes:
        io.save(motion, tmp_path / "out.bvh")
        return (tmp_path / "out.bvh").read_bytes()

    return save


@real_files
def test_D23_real_files_come_back_byte_for_byte(path, written):
    needs(path)
    assert written(io.load(path)) == path.read_bytes()


@real_files
def test_D20_D23_real_files_rewritten(path, written, tmp_path):
    needs(path)
    before = io.load(path)
    after = turned(before, 1e-3)
    content = written(after)
    again = io.load(tmp_path / "out.bvh")
    channelled = [bool(j.axes) for j in before.source.joints]
    assert_same_rotation(again.q[:, channelled], after.q[:, channelled], DECIMALS)
    assert header_of(content) == header_of(path.read_bytes())
    assert torch.equal(again.root_position, before.root_position)


@real_files
def test_second_opinion_pybvh(path, tmp_path):
    needs(path)
    text = path.read_bytes().decode("latin-1").splitlines()
    first = next(i for i, line in enumerate(text) if line.lower().startswith("frame time")) + 1
    rows = [row for row in text[first:] if row.strip()][:100]
    text[first - 2] = f"Frames: {len(rows)}"
    short = tmp_path / "short.bvh"
    short.write_text("\n".join([*text[:first], *rows]) + "\n", encoding="latin-1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns about axes that it guesses
        other = pybvh.read_bvh_file(short)
        root, matrices = other.to_rotmat()
    motion = io.load(short)
    assert motion.names == tuple(other.joint_names)
    assert np.abs(quaternion_matrix(numpy_of(motion.q)) - matrices).max() < 1e-6
    assert np.allclose(root, motion.root_position)


def test_D12_second_opinion_pymotion_on_six_channels(load, tmp_path, rng):
    angles = 170 * (2 * torch.rand(30, 2, 3, generator=rng).double() - 1)
    places = torch.randn(30, 2, 3, generator=rng).double()
    rows = torch.cat([places, angles], -1).reshape(30, 12).tolist()
    channels = f"{POSITIONS} {ROTATIONS}"
    motion = load(bvh_text(joint("a", channels, joint("b", channels, end_site="0 1 0")), rows=rows))
    other = BVH()
    other.load(str(tmp_path / "walk.bvh"))
    q, positions = other.get_data()[:2]
    assert_same_rotation(motion.q, torch.from_numpy(q[..., [1, 2, 3, 0]]), 1e-6)
    assert np.allclose(positions[:, 0], motion.root_position)


@pytest.mark.parametrize("order", ORDERS)
def test_D11_D20_every_order_is_kept(order, load, written, tmp_path, rng):
    rows = (360 * torch.rand(50, 3, generator=rng).double() - 180).tolist()
    before = load(one_joint(*rows, channels=rotation_channels(order)))
    after = before.with_rotations(random_rotations(50, 1, rng=rng))
    content = written(after)
    assert f"CHANNELS 3 {rotation_channels(order)}".encode() in content
    assert_same_rotation(io.load(tmp_path / "out.bvh").q, after.q, DECIMALS)


def test_D12_D13_only_rotations_of_changed_joints_change(load, written):
    text = bvh_text(
        joint(
            "a",
            f"{ROTATIONS} {POSITIONS}",
            joint("b", ROTATIONS),
            joint("c", "Xrotation"),
            joint("d", ""),
        ),
        rows=["10 20 30  1.50 +2 3e0 40 50 60\t70.125", "11 21 31  1.50 +2 3e0 41 51 61\t71.125"],
    )
    before = load(text)
    q = before.q.clone()
    q[:, 1] = turned(before).q[:, 1]
    rows = written(before.with_rotations(q)).decode().splitlines()[-2:]
    assert rows[0].startswith("10 20 30  1.50 +2 3e0 ") and rows[0].endswith("\t70.125")
    assert rows[0].split()[6:9] != ["40", "50", "60"]


def test_D1_an_irregular_file_keeps_its_looks(load, written):
    before = load(IRREGULAR)
    assert written(before) == IRREGULAR
    content = written(turned(before))
    assert content[: content.index(b"/s") if b"/s" in content else 60] == IRREGULAR[:60]
    assert header_of(content) == header_of(IRREGULAR) and content.count(b"\r\n") == IRREGULAR.count(
        b"\r\n"
    )


def test_D20_fixed_point_digits_in_any_locale(load, written):
    before = load(one_joint(*[[0.0, 0.0, 0.0]] * 3))
    content = written(turned(before, 1e-7))
    old = locale.setlocale(locale.LC_ALL)
    for name in ("de_DE.UTF-8", "fr_FR.UTF-8"):
        try:
            locale.setlocale(locale.LC_ALL, name)
        except locale.Error:
            continue
        try:
            assert written(turned(before, 1e-7)) == content
        finally:
            locale.setlocale(locale.LC_ALL, old)
    assert b"e" not in content[content.index(b"Frame Time") + 11 :] and b"0.000006" in content


def lock_path(order):
    """The middle angle goes from 80 to 100 degrees, through gimbal lock, in 240 frames."""
    t = np.linspace(0.0, 1.0, 240)
    return euler_quaternion(order, np.stack([20 + 15 * t, 80 + 20 * t, -30 + 25 * t], -1))


@pytest.mark.parametrize("order", ORDERS)
def test_D21_a_path_through_gimbal_lock(order, load, written, tmp_path):
    q = torch.from_numpy(lock_path(order))[:, None]
    before = load(one_joint(*[[20.0, 80.0, -30.0]] * 240, channels=rotation_channels(order)))
    content = written(before.with_rotations(q))
    assert_same_rotation(io.load(tmp_path / "out.bvh").q, q, 1e-6)
    step = np.abs(np.diff(motion_rows(content), axis=0)).max()
    assert step <= 1.0, f"largest step {step:.2f} degrees"


def test_D19_D20_angles_go_on_beyond_180_degrees(load, written):
    """Three full turns about one axis: no jump by 360 degrees."""
    rows = [[4.0 * t, 0.0, 0.0] for t in range(270)]
    before = load(one_joint(*rows))
    angles = motion_rows(written(turned(before, 1e-9)))
    assert np.abs(np.diff(angles, axis=0)).max() < 4.1 and angles[-1, 0] > 1000


def test_D24_onto_the_input_and_interrupted(load, tmp_path, monkeypatch):
    before = load(one_joint("10 20 30", "11 21 31"))
    path = tmp_path / "walk.bvh"
    path.chmod(0o640)
    io.save(turned(before), path)
    content = path.read_bytes()
    assert_same_rotation(io.load(path).q, turned(before).q, DECIMALS)
    assert path.stat().st_mode & 0o777 == 0o640

    for name in ("fsync", "fdopen"):
        with monkeypatch.context() as broken:

            def interrupt(*_, **__):
                raise KeyboardInterrupt

            broken.setattr(f"torchquat.io.files.os.{name}", interrupt)
            with pytest.raises(KeyboardInterrupt):
                io.save(before, path)
        assert path.read_bytes() == content
        assert [each.name for each in tmp_path.iterdir()] == ["walk.bvh"]


def test_missing_rotations_are_refused(load, tmp_path):
    before = load(one_joint("10 20 30", "11 21 31"))
    q = before.q.clone()
    q[1] = torch.nan
    with pytest.raises(ValueError, match="q must hold no missing rotation to be written, got some"):
        io.save(before.with_rotations(q), tmp_path / "out.bvh")
    assert not (tmp_path / "out.bvh").exists()


def test_a_file_for_a_motion_from_elsewhere(tmp_path, rng):
    """Every line of it: the root's position channels first, no position on any other joint."""
    offsets = torch.tensor([[1.0, 2, 3], [0, 4, 0], [0.5, 0, 0]]).double()
    skeleton = Skeleton(("hip", "leg", "arm"), (-1, 0, 0), offsets, ((2, (0.0, 1.5, 0.0)),))
    q = random_rotations(2, 3, rng=rng)
    place = torch.tensor([[1.0, 2.5, 3], [1.25, 2.5, 3]]).double()
    motion = io.Motion(q, 50.0, skeleton.names, skeleton=skeleton, root_position=place)
    io.save(motion, tmp_path / "new.bvh")
    *header, first, second = (tmp_path / "new.bvh").read_text(encoding="ascii").splitlines()
    turns = "Zrotation Xrotation Yrotation"
    assert header == [
        "HIERARCHY",
        "ROOT hip",
        "{",
        "\tOFFSET 1.000000 2.000000 3.000000",
        f"\tCHANNELS 6 Xposition Yposition Zposition {turns}",
        "\tJOINT leg",
        "\t{",
        "\t\tOFFSET 0.000000 4.000000 0.000000",
        f"\t\tCHANNELS 3 {turns}",
        "\t}",
        "\tJOINT arm",
        "\t{",
        "\t\tOFFSET 0.500000 0.000000 0.000000",
        f"\t\tCHANNELS 3 {turns}",
        "\t\tEnd Site",
        "\t\t{",
        "\t\t\tOFFSET 0.000000 1.500000 0.000000",
        "\t\t}",
        "\t}",
        "}",
        "MOTION",
        "Frames: 2",
        "Frame Time: 0.02000000",
    ]
    assert [row.split()[:3] for row in (first, second)] == [
        ["1.000000", "2.500000", "3.000000"],
        ["1.250000", "2.500000", "3.000000"],
    ]
    back = io.load(tmp_path / "new.bvh")
    assert_same_rotation(back.q, q, DECIMALS)
    for shortened in (lambda: back.with_rotations(q[:1]), lambda: replace(back, q=q[:1])):
        with pytest.raises(ValueError, match=r"^q must have shape \(2, 3, 4\), got \(1, 3, 4\)"):
            io.save(shortened(), tmp_path / "short.bvh")
    with pytest.raises(ValueError, match=r"^motion must have a skeleton to be written as BVH, got"):
        io.save(io.Motion(q, 50.0, skeleton.names), tmp_path / "new.bvh")


def test_names_in_any_encoding_are_written_as_they_were_read(load, tmp_path):
    """Bytes that are not UTF-8, into a file that is made anew."""
    before = load(one_joint("10 20 30").encode().replace(b"ROOT hip", b"ROOT caf\xe9"))
    motion = io.Motion(before.q, 30.0, before.names, skeleton=before.skeleton)
    io.save(motion, tmp_path / "new.bvh")
    assert b"ROOT caf\xe9\n" in (tmp_path / "new.bvh").read_bytes()
    assert io.load(tmp_path / "new.bvh").names == before.names


def test_D17_roots_and_children_keep_their_order_in_a_new_file(rng, tmp_path):
    still = torch.zeros(4, 3, dtype=torch.float64)
    skeleton = Skeleton(("a", "b", "c", "d"), (-1, -1, 0, 0), still)
    io.save(
        io.Motion(random_rotations(1, 4, rng=rng), 30.0, skeleton.names, skeleton=skeleton),
        tmp_path / "new.bvh",
    )
    assert io.load(tmp_path / "new.bvh").names == ("a", "c", "d", "b")
