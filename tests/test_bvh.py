"""BVH files read: what real exporters write is accepted, the rest refused with its place."""

import re

import numpy as np
import pytest
import torch
from bvh_files import (
    FIRST_ROW,
    IRREGULAR,
    ORDERS,
    POSITIONS,
    ROTATIONS,
    bvh_text,
    euler_matrix,
    euler_quaternion,
    joint,
    one_joint,
    quaternion_matrix,
    rotation_channels,
)
from motions import IDENTITY, assert_same_rotation, numpy_of

from torchquat import io, so3
from torchquat.io import FormatError
from torchquat.io.bvh import read_bvh

ROWS = ["10 20 30", "11 21 31", "12 22 32"]


@pytest.fixture
def read(tmp_path):
    """Write a text or bytes, and load it."""

    def load(content: str | bytes, **options):
        path = tmp_path / "walk.bvh"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return io.load(path, **options)

    return load


@pytest.fixture
def refused(read):
    """Load what must be refused; returns the message after the path."""

    def message(content: str | bytes) -> str:
        with pytest.raises(FormatError) as caught:
            read(content)
        return str(caught.value).partition("walk.bvh")[2]

    return message


def test_D1_line_ends_blanks_and_tabs(read):
    text = one_joint(*ROWS)
    expected = read(text)
    for other in (
        text.replace("\n", "\r\n"),
        text.replace("\n", " \t\n"),
        text.replace(" ", "\t"),
        text.rstrip("\n"),
        text + "\n \n\t\n",
        text.replace("MOTION\n", "\n\nMOTION\n\n"),
        text.replace("\n{\n", " {\n"),
    ):
        motion = read(other)
        assert torch.equal(motion.q, expected.q) and motion.frame_rate == expected.frame_rate


def test_D1_an_irregular_file(read):
    motion = read(IRREGULAR)
    assert motion.q.shape == (3, 3, 4)
    assert motion.frame_rate == pytest.approx(1 / 0.0083333)
    assert motion.skeleton.parents == (-1, 0, 0)
    assert motion.skeleton.offsets.tolist() == [[0, 10, -0.5], [1, 2, 3], [1, 2, 3]]
    assert motion.skeleton.end_sites == ((1, (0.0, 0.0, 0.25)),)
    assert motion.root_position.tolist() == [[1.5, 2, 3]] * 3
    expected = [
        euler_quaternion("ZYX", np.array([10.0, 20, 30])),
        euler_quaternion("YXZ", np.array([600.0, -5, 0.25])),
        euler_quaternion("X", np.array([4.0])),
    ]
    assert_same_rotation(motion.q[0], torch.from_numpy(np.array(expected)))


def test_D2_byte_order_mark_and_bytes_that_are_not_utf8(read, tmp_path):
    text = one_joint(*ROWS).encode()
    assert torch.equal(read(b"\xef\xbb\xbf" + text).q, read(text).q)
    odd = text.replace(b"hip", b"h\xfcft \xff")
    io.save(read(odd), tmp_path / "out.bvh")
    assert (tmp_path / "out.bvh").read_bytes() == odd


@pytest.mark.parametrize("mark", ["\x0b", "\x85", "\u2028", "\x0c"])
def test_D3_odd_marks_in_a_name_end_no_line(mark, read):
    assert read(one_joint(*ROWS).replace("hip", f"hi{mark}p")).names == (f"hi{mark}p",)


def test_D4_numbers_in_any_notation(read):
    motion = read(one_joint("1e1 1E+2 -.5", "+3 1e-05 7."))
    expected = euler_quaternion("ZXY", np.array([[10, 100, -0.5], [3, 1e-5, 7]]))
    assert_same_rotation(motion.q[:, 0], torch.from_numpy(expected))


@pytest.mark.parametrize(
    "token", ["1,5", "1_000", "nan", "inf", "1e400", "\uff11", "0x10", "4.0e-", "--1", "1e"]
)
def test_D5_refuses_what_is_no_number(token, refused):
    message = refused(one_joint(ROWS[0], f"11  {token} 31"))
    assert message.startswith(f":{FIRST_ROW + 1}:5: expected a number, got '{token}'")


def test_D6_refuses_glued_numbers(refused):
    message = refused(one_joint("1.5 0.0-7.5094748 3"))
    assert message == f":{FIRST_ROW}:5: expected a number, got '0.0-7.5094748'"


@pytest.mark.parametrize("count", [2, 4])
def test_D7_counts_that_differ(count, refused, read, tmp_path):
    text = one_joint(*ROWS, frames=count)
    assert refused(text).endswith(f": expected {count} rows of motion, got 3")
    with pytest.warns(UserWarning, match=f"expected {count} rows of motion, got 3: using these"):
        motion = read(text, lenient=True)
    io.save(motion, tmp_path / "counted.bvh")
    assert (tmp_path / "counted.bvh").read_text() == one_joint(*ROWS)
    (tmp_path / "strict.bvh").write_text(text)
    with pytest.raises(FormatError, match=f"expected {count} rows of motion, got 3"):
        read_bvh(tmp_path / "strict.bvh")  # nobody asked for leniency


def test_D7_the_warning_names_the_line_of_the_caller(read):
    with pytest.warns(UserWarning) as told:
        read(one_joint(*ROWS, frames=2), lenient=True)
    assert told[0].filename == __file__


@pytest.mark.parametrize("count", ["-1", "x", "2.0", "", "1 2"])
def test_D8_refuses_other_counts(count, refused):
    message = refused(one_joint(*ROWS, frames=count))
    assert re.fullmatch(r":8: expected Frames:( and a count >= 0)?, got 'Frames:.*'", message)


def test_D8_no_frames(read, tmp_path):
    motion = read(one_joint())
    assert motion.q.shape == (0, 1, 4)
    io.save(motion, tmp_path / "out.bvh")
    assert len(io.load(tmp_path / "out.bvh").q) == 0


@pytest.mark.parametrize("seconds", ["0", "-0.01", "nan", "", "1e-320", "0,01"])
def test_D9_refuses_other_frame_times(seconds, refused):
    message = refused(one_joint(*ROWS, frame_time=seconds))
    assert message.startswith(f":{FIRST_ROW - 1}")
    wanted = "Frame Time: and seconds > 0, got 'Frame Time:" if seconds in ("0", "-0.01") else ""
    assert wanted in message


def test_D9_the_column_is_that_of_the_number(refused):
    """Not that of the same letter further to the left."""
    message = refused(one_joint(*ROWS, frame_time="m"))
    assert message == f":{FIRST_ROW - 1}:13: expected a number, got 'm'"


def test_D9_frame_time_missing(refused):
    text = one_joint(*ROWS).replace("Frame Time: 0.01\n", "")
    assert "expected Frame Time:, got '10 20 30'" in refused(text)


@pytest.mark.parametrize("row", ["1 2", "1 2 3 4"])
def test_D10_rows_of_another_width(row, refused):
    message = refused(one_joint(ROWS[0], row, ROWS[1]))
    assert message == f":{FIRST_ROW + 1}: expected 3 values in a row, got {len(row.split())}"


def test_D10_a_row_split_over_two_lines(refused):
    assert refused(one_joint("1 2", "3", frames=1)).startswith(f":{FIRST_ROW}: expected 3 values")


@pytest.mark.parametrize("order", ORDERS)
def test_D11_six_rotation_orders(order, read):
    angles = [[30.0, -50.0, 110.0], [-170.0, 80.0, 5.0]]
    q = read(one_joint(*angles, channels=rotation_channels(order))).q[:, 0]
    expected = [euler_matrix(order, row) for row in angles]
    assert np.allclose(quaternion_matrix(numpy_of(q)), expected, atol=1e-12)


def test_A24_a_quarter_turn_about_z_sends_x_to_y(read):
    q = read(one_joint("90 0 0")).q
    assert torch.allclose(so3.rotate(q, torch.eye(3).double()[0]), torch.eye(3).double()[1])


def test_D11_orders_mixed_in_one_file(read):
    text = bvh_text(
        joint("a", rotation_channels("ZXY"), joint("b", rotation_channels("XYZ"))),
        rows=["10 20 30 40 50 60"],
    )
    q = numpy_of(read(text).q)[0]
    assert np.allclose(quaternion_matrix(q[0]), euler_matrix("ZXY", [10, 20, 30]))
    assert np.allclose(quaternion_matrix(q[1]), euler_matrix("XYZ", [40, 50, 60]))


def test_D12_positions_after_rotations_and_on_every_joint(read):
    channels = f"{ROTATIONS} {POSITIONS}"
    motion = read(
        bvh_text(joint("a", channels, joint("b", channels)), rows=["1 2 3 4 5 6 7 8 9 10 11 12"])
    )
    expected = euler_quaternion("ZXY", np.array([[1.0, 2, 3], [7, 8, 9]]))
    assert_same_rotation(motion.q[0], torch.from_numpy(expected))
    assert motion.root_position.tolist() == [[4, 5, 6]]


@pytest.mark.parametrize(
    ("channels", "row", "order"),
    [
        ("", "", ""),
        ("Yrotation", "30", "Y"),
        ("Zrotation Xrotation", "30 40", "ZX"),
        ("Xposition Zrotation", "5 40", "Z"),
    ],
)
def test_D13_joints_with_few_channels(channels, row, order, read):
    text = bvh_text(joint("a", ROTATIONS, joint("b", channels)), rows=[f"0 0 0 {row}"])
    angles = np.array([float(word) for word in row.split()][-len(order) :] if order else [])
    expected = torch.from_numpy(euler_quaternion(order, angles)) if order else IDENTITY
    assert_same_rotation(read(text).q[0, 1], expected)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("CHANNELS 3 Zrotation Zrotation Yrotation", "expected every channel once, got Zrotation"),
        ("CHANNELS 3 Zrotation Xrotation Wrotation", "expected one of Xposition, .*'Wrotation'"),
        ("CHANNELS 3 Zrotation Xrotation", "expected CHANNELS 2, got CHANNELS '3'"),
        ("CHANNELS x Zrotation", "expected CHANNELS 1, got CHANNELS 'x'"),
        ("CHANELS 3 Zrotation Xrotation Yrotation", "expected CHANNELS, JOINT, .*got 'CHANELS 3"),
        ("OFFSET 0 0", "expected CHANNELS, JOINT"),
    ],
)
def test_D14_refuses_other_channels(line, message, read):
    text = one_joint(*ROWS).replace(f"CHANNELS 3 {ROTATIONS}", line)
    with pytest.raises(FormatError, match=f"walk.bvh:5: {message}"):
        read(text)


def test_D15_end_sites_go_by_their_keyword(read):
    text = bvh_text(
        joint("a", ROTATIONS, joint("RightShould_End", ROTATIONS, end_site="0 0 1")),
        rows=["0 0 0 10 20 30"],
    )
    motion = read(text)
    assert motion.names == ("a", "RightShould_End")
    assert motion.skeleton.end_sites == ((1, (0.0, 0.0, 1.0)),)


def test_D16_names_are_kept_and_may_be_shared(read):
    names = ("mixamo:Left Hip.1-x", "b", "b")
    motion = read(
        bvh_text(
            joint(names[0], ROTATIONS, joint("b", ROTATIONS), joint("b", ROTATIONS)),
            rows=["1 2 3 4 5 6 7 8 9"],
        )
    )
    assert motion.names == names and not torch.equal(motion.q[:, 1], motion.q[:, 2])


def test_D17_two_roots_keep_their_order(read):
    motion = read(bvh_text(joint("a", ROTATIONS), joint("b", ROTATIONS), rows=["1 2 3 4 5 6"]))
    assert motion.names == ("a", "b") and motion.skeleton.parents == (-1, -1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ": expected HIERARCHY, got the end of the file"),
        ("MOTION\n", ":1: expected HIERARCHY, got 'MOTION'"),
        ("HIERARCHY\nMOTION\n", ":2: expected ROOT, got 'MOTION'"),
        ("HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n", ": expected } or MOTION, got the end of the file"),
        ("HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\n}\n", ":6: expected ROOT or MOTION, got '}'"),
        ("HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\n", ": expected } or MOTION, got the end of the"),
        ("HIERARCHY\nROOT\n{\n", ":2: expected a name after 'ROOT', got none"),
        ("HIERARCHY\nROOT a\nOFFSET 0 0 0\n", ":3: expected {, got 'OFFSET 0 0 0'"),
        ("HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\nMOTION\n\n", ": expected Frames:, got the end of"),
        ("HIERARCHY\nROOT a\n{\n}\n", ":4: expected OFFSET, CHANNELS, JOINT, End Site, got '}'"),
    ],
)
def test_D18_broken_hierarchies(content, message, refused):
    assert refused(content).startswith(message)


def test_D18_depth_10000(read):
    """Deeper than any call stack: nothing here recurses."""
    lines = ["HIERARCHY"]
    for depth in range(10000):
        lines += [f"{'JOINT' if depth else 'ROOT'} j{depth}", "{", "OFFSET 0 1 0", "CHANNELS 0"]
    lines += ["}"] * 10000 + ["MOTION", "Frames: 0", "Frame Time: 0.01", ""]
    assert len(read("\n".join(lines)).names) == 10000


def test_D18_a_line_without_an_end(refused):
    assert len(refused("HIERARCHY " + "x" * 10_000_000)) < 200


def test_offsets_keep_all_their_digits(read):
    motion = read(bvh_text(joint("hip", ROTATIONS, end_site="0.1 0.2 0.7"), rows=[[1, 2, 3]]))
    assert motion.skeleton.end_sites == ((0, (0.1, 0.2, 0.7)),)
    text = one_joint(*ROWS).replace("OFFSET 0 0 0", "OFFSET 0.1 -0.7 1e-17", 1)
    assert read(text).skeleton.offsets.tolist() == [[0.1, -0.7, 1e-17]]


def test_D19_angles_beyond_full_turns(read):
    q = read(one_joint("600 -190 725", "240 170 5")).q
    assert_same_rotation(q[0], q[1], 1e-12)


def test_D22_middle_angle_of_90_degrees(read, tmp_path):
    motion = read(one_joint("10 90 30", "20 -90 40", "30 90 50"))
    turned = motion.with_rotations(so3.compose(motion.q, so3.exp(torch.zeros(3).double() + 1e-9)))
    io.save(turned, tmp_path / "out.bvh")
    assert_same_rotation(io.load(tmp_path / "out.bvh").q, motion.q, 5e-8)
