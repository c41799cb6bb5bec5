"""npz files: AMASS and plain; nothing is unpickled, nothing but rotations changes."""

import io as memory
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from motions import assert_same_rotation, random_rotations
from scipy.spatial.transform import Rotation

from torchquat import io, so3
from torchquat.io import FormatError, Motion, _zip

SHARED = Path(__file__).parents[2] / "shared" / "data" / "estimates" / "smpl_video"
REAL = sorted(SHARED.glob("*.npz"))
QUARTER = np.sqrt(0.5)


class Bomb:
    """Unpickled, it would write a file."""

    def __reduce__(self):
        return (open, ("exploded", "w"))


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "walk.npz"


@pytest.fixture
def refused(path):
    """Load what must be refused; returns the message. Nothing may have been executed."""

    def message(*match: str) -> None:
        with pytest.raises(FormatError) as caught:
            io.load(path)
        assert all(part in str(caught.value) for part in (str(path), *match)), caught.value
        assert not Path("exploded").exists(), "a pickle was run"

    return message


def amass(width=156, frames=5, **changed):
    """The arrays of an AMASS file, with those given put in, or left out where ``None``."""
    poses = np.random.default_rng(0).normal(0, 0.4, (frames, width))
    arrays = {
        "trans": np.zeros((frames, 3)),
        "gender": np.array("neutral"),
        "mocap_framerate": np.array(120.0),
        "betas": np.arange(16.0),
        "poses": poses,
    }
    return {key: value for key, value in (arrays | changed).items() if value is not None}


def entries(content: Path | bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(
        memory.BytesIO(content) if isinstance(content, bytes) else content
    ) as file:
        return {name: file.read(name) for name in file.namelist()}


def turned(motion):
    turn = so3.exp(torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    return motion.with_rotations(so3.compose(motion.q, turn))


def test_E1_object_arrays_are_refused_not_run(path, refused):
    np.savez(path, **amass(poses=np.array([Bomb()], dtype=object)))
    refused("poses", "expected a plain array, got Python objects")
    np.savez(path, **amass(labels=np.array([Bomb()], dtype=object)))
    refused("labels", "Python objects")


def test_E1_the_one_object_array_of_amass_is_carried_as_bytes(path, tmp_path):
    """SMPL-X files of AMASS hold a dictionary there; it is never looked into."""
    np.savez(path, **amass(165, markers_latent_vids=np.array([Bomb()], dtype=object)))
    io.save(turned(io.load(path)), tmp_path / "out.npz")
    assert not Path("exploded").exists(), "a pickle was run"
    name = "markers_latent_vids.npy"
    assert entries(tmp_path / "out.npz")[name] == entries(path)[name]


def test_E2_a_pickle_with_another_name(path, refused):
    path.write_bytes(pickle.dumps(Bomb()))
    refused("expected an npz archive")


def test_E3_a_header_that_claims_more_than_there_is(path, refused):
    stream = memory.BytesIO()
    claim = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 72)}
    np.lib.format.write_array_header_1_0(stream, claim)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("poses.npy", stream.getvalue() + bytes(64))
    refused("poses: expected 576000000000000 bytes for shape (1000000000000, 72), got 64")


def test_E3_more_unpacked_bytes_than_the_limit(path, refused, monkeypatch):
    np.savez_compressed(path, **amass(poses=np.zeros((1000, 72))))
    monkeypatch.setattr(_zip, "MAX_BYTES", 100_000)
    refused("expected at most 100000 bytes, got 57")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda content: content[: len(content) // 2], "expected an npz archive"),
        (lambda content: b"", "expected an npz archive"),
        (lambda content: b"BVH", "expected an npz archive"),
        (lambda content: content.replace(b"poses.npy", b"poses.txt"), "expected NAME.npy"),
        (lambda content: content.replace(b"poses.npy", b"../xs.npy"), "expected NAME.npy"),
        (lambda content: content.replace(b"betas.npy", b"poses.npy"), "once, got it twice"),
        (lambda content: content.replace(b"\x93NUMPY", b"\x93NUMPI"), "expected an npz archive"),
    ],
    ids=["truncated", "empty", "text", "other name", "outside", "duplicate", "checksum"],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_E4_unsound_archives(spoil, message, path, refused):
    np.savez(path, **amass(72))
    path.write_bytes(spoil(path.read_bytes()))
    refused(message)


def test_E4_encrypted_entries(path, refused):
    np.savez(path, **amass(72))
    content = bytearray(path.read_bytes())
    central = content.index(b"PK\x01\x02")
    content[central + 8] |= 0x1  # the flag in the directory
    path.write_bytes(bytes(content))
    refused("expected plain entries, got an encrypted one")


@pytest.mark.parametrize("key", ["mocap_framerate", "mocap_frame_rate"])
def test_E5_both_spellings_of_the_frame_rate(key, path):
    np.savez(path, **amass(72, mocap_framerate=None) | {key: np.array(60)})
    assert io.load(path).frame_rate == 60.0


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, "fast", [1.0, 2.0]])
def test_E5_other_frame_rates(rate, path, refused):
    np.savez(path, **amass(72, mocap_framerate=np.array(rate)))
    refused("mocap_framerate: expected frames per second")


def test_E5_no_frame_rate_lists_the_keys(path, refused):
    np.savez(path, **amass(72, mocap_framerate=None))
    refused("expected mocap_framerate or mocap_frame_rate, got ['trans', 'gender', 'betas', 'pos")
    refused("'poses']: use io.load_estimate")


@pytest.mark.parametrize(("width", "joints"), [(72, 24), (147, 49), (156, 52), (165, 55), (3, 1)])
def test_E6_widths(width, joints, path):
    arrays = amass(width)
    np.savez(path, **arrays)
    motion = io.load(path)
    assert motion.q.shape == (5, joints, 4)
    expected = Rotation.from_rotvec(arrays["poses"].reshape(-1, 3)).as_quat()
    assert_same_rotation(motion.q.reshape(-1, 4), torch.from_numpy(expected))


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (np.zeros((5, 73)), "expected a width of 3 J, got 73"),
        (np.zeros((5, 0)), "expected a width of 3 J, got 0"),
        (np.zeros(72), "poses: expected 2 dimensions of floating-point numbers, got float64 (72,)"),
        (np.zeros((5, 72), dtype=int), "floating-point numbers, got int64"),
        (np.zeros((5, 72), dtype=complex), "floating-point numbers, got complex128"),
    ],
)
def test_E6_E8_other_poses(poses, message, path, refused):
    np.savez(path, **amass(72, poses=poses))
    refused(message)


def test_E6_no_frames(path, tmp_path):
    np.savez(path, **amass(72, frames=0))
    motion = io.load(path)
    assert motion.q.shape == (0, 24, 4)
    io.save(motion.with_rotations(motion.q), tmp_path / "out.npz")
    assert entries(tmp_path / "out.npz") == entries(path)


@pytest.mark.parametrize("gender", ["female", b"female", ["female"], np.array("male")])
def test_E7_gender_and_unknown_keys_pass_through(gender, path, tmp_path):
    np.savez(path, **amass(72, gender=np.array(gender), mine=np.arange(7, dtype=">i2")))
    io.save(turned(io.load(path)), tmp_path / "out.npz")
    before, after = entries(path), entries(tmp_path / "out.npz")
    assert list(after) == list(before)
    assert [name for name in before if after[name] != before[name]] == ["poses.npy"]


@pytest.mark.parametrize("dtype", [">f4", ">f8", "<f2", "<f4", "<f8", np.longdouble])
def test_E8_dtypes_are_converted_and_kept(dtype, path, tmp_path):
    poses = amass(72)["poses"].astype(dtype)
    np.savez(path, **amass(72, poses=poses[::-1, ::-1]))
    motion = io.load(path)
    expected = Rotation.from_rotvec(poses[::-1, ::-1].astype(float).reshape(-1, 3)).as_quat()
    assert_same_rotation(motion.q.reshape(-1, 4), torch.from_numpy(expected))
    io.save(turned(motion), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        assert file["poses"].dtype == np.dtype(dtype)
    tolerance = {2: 4e-3, 4: 2e-6}.get(np.dtype(dtype).itemsize, 1e-12)
    assert_same_rotation(io.load(tmp_path / "out.npz").q, turned(motion).q, tolerance)


def test_E9_nan_poses_are_missing_frames(path):
    poses = amass(72)["poses"]
    poses[2, 4] = np.nan
    np.savez(path, **amass(72, poses=poses))
    valid = io.load(path).valid
    assert not valid[2, 1] and int((~valid).sum()) == 1


def test_E9_missing_frames_are_written_as_missing_not_as_the_identity(path, tmp_path):
    poses = amass(72)["poses"]
    poses[2, 4] = np.nan
    np.savez(path, **amass(72, poses=poses))
    io.save(turned(io.load(path)), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        assert np.isnan(file["poses"][2, 3:6]).all() and np.isnan(file["poses"]).sum() == 3


def test_E10_rotation_vectors_stay_on_their_branch(path, tmp_path):
    """A turn about one axis, three times round: no jump by 2 pi, the first frame as it was."""
    angle = np.linspace(4.0, 22.0, 90)
    poses = np.zeros((90, 6))
    poses[:, 1] = angle
    poses[:, 5] = np.where(np.arange(90) % 2, 0.1, 0.1 + 2 * np.pi)  # jumps to and fro
    np.savez(path, **amass(6, frames=90, poses=poses))
    motion = io.load(path)
    assert_same_rotation(motion.q[0, 1], motion.q[1, 1], 1e-12)
    nudge = so3.exp(torch.tensor([0.0, 1e-3, 0.0], dtype=torch.float64))
    io.save(motion.with_rotations(so3.compose(motion.q, nudge)), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        assert np.abs(np.diff(file["poses"], axis=0)).max() < 0.25
        assert np.allclose(file["poses"][:, 1], angle + 1e-3, atol=1e-9)


@pytest.mark.parametrize(
    ("width", "spans"),
    [
        (156, {"root_orient": (0, 3), "pose_body": (3, 66), "pose_hand": (66, 156)}),
        (
            165,
            {
                "root_orient": (0, 3),
                "pose_body": (3, 66),
                "pose_jaw": (66, 69),
                "pose_eye": (69, 75),
                "pose_hand": (75, 165),
            },
        ),
    ],
)
def test_the_pose_stored_twice_stays_consistent(width, spans, path, tmp_path):
    poses = amass(width)["poses"]
    parts = {key: poses[:, slice(*span)].astype("f4") for key, span in spans.items()}
    np.savez(path, **amass(width) | parts)
    before = io.load(path)
    io.save(turned(before), tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as file:
        assert not np.allclose(file["poses"], poses, atol=0.1)
        for key, span in spans.items():
            assert file[key].dtype == np.float32
            assert np.allclose(file[key], file["poses"][:, slice(*span)], atol=1e-6)


def test_parts_that_contradict_the_pose(path, refused):
    np.savez(path, **amass(156), root_orient=np.ones((5, 3)))
    refused("root_orient: expected what 'poses' holds, got other values")
    np.savez(path, **amass(156), root_orient=np.ones((4, 3)))
    refused("root_orient: expected shape (5, 3), got (4, 3)")


def test_joints_that_did_not_change_keep_their_numbers(path, tmp_path):
    np.savez(path, **amass(72))
    before = io.load(path)
    q = before.q.clone()
    q[:, 3] = turned(before).q[:, 3]
    io.save(before.with_rotations(q), tmp_path / "out.npz")
    with np.load(path) as old, np.load(tmp_path / "out.npz") as new:
        same = (old["poses"] == new["poses"]).all(0).reshape(24, 3).all(-1)
    assert same.tolist() == [joint != 3 for joint in range(24)]


@pytest.mark.parametrize("real", REAL or [None], ids=lambda p: p.stem if p else "none")
def test_real_files_come_back_byte_for_byte(real, tmp_path):
    if real is None:
        pytest.skip("../shared/data is absent")
    motion = io.load(real)
    io.save(motion, tmp_path / "out.npz")
    assert entries(tmp_path / "out.npz") == entries(real)
    io.save(turned(motion), tmp_path / "out.npz")
    assert_same_rotation(io.load(tmp_path / "out.npz").q, turned(motion).q, 2e-6)


FIXTURES = {  # rotations by hand: their quaternions x, y, z, w
    "x": [QUARTER, 0, 0, QUARTER],
    "y": [0, QUARTER, 0, QUARTER],
    "z": [0, 0, QUARTER, QUARTER],
    "mixed": [0.5, 0.5, 0.5, 0.5],
}


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_A24_plain_files_say_their_order(order, path, tmp_path):
    q = np.array(list(FIXTURES.values()))[:, None]
    stored = q if order == "xyzw" else q[..., [3, 0, 1, 2]]
    np.savez(path, q=stored, order=order, frame_rate=30.0)
    motion = io.load(path)
    assert_same_rotation(motion.q, torch.from_numpy(q))
    images = so3.rotate(motion.q[:, 0], torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64))
    expected = torch.tensor([[1, 0, 0], [0, 0, -1], [0, 1, 0], [0, 1, 0]], dtype=torch.float64)
    assert torch.allclose(images, expected, atol=1e-12)
    io.save(turned(motion), tmp_path / "out.npz")
    assert_same_rotation(io.load(tmp_path / "out.npz").q, turned(motion).q)
    with np.load(tmp_path / "out.npz") as file:
        assert str(file["order"]) == order


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"order": None}, "expected the key 'order', got ['q', 'frame_rate']"),
        ({"order": "zyxw"}, "order: expected one of ['xyzw', 'wxyz'], got 'zyxw'"),
        ({"frame_rate": None}, "expected the key 'frame_rate'"),
        ({"q": np.ones((4, 2, 3))}, "q: expected shape (T, J, 4), got (4, 2, 3)"),
        ({"q": np.ones((4, 4))}, "q: expected 3 dimensions"),
        ({"names": np.array(["a"])}, "(T, 1, 4), got (4, 2, 4)"),
        ({"weight": np.ones((3, 2))}, "walk.npz"),
        ({"parents": np.array([-1, 5]), "offsets": np.ones((2, 3))}, "parents must be < their"),
    ],
)
def test_plain_files_that_contradict_themselves(changed, message, path, refused):
    arrays = {"q": np.ones((4, 2, 4)), "order": "xyzw", "frame_rate": 30.0} | changed
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    refused(message)


def test_neither_poses_nor_quaternions(path, refused):
    np.savez(path, angles=np.ones(3))
    refused("expected the key 'poses' or 'q', got ['angles']")


def test_plain_files_keep_weights_and_gaps(path, rng):
    q = random_rotations(4, 2, rng=rng)
    q[1, 0] = torch.nan
    weight = torch.rand(4, 2, generator=rng).double()
    io.save(Motion(q, 30.0, ("a", "b"), weight=weight), path)
    again = io.load(path)
    assert torch.equal(again.weight, weight) and again.q[1, 0].isnan().all()
    io.save(turned(again).with_rotations(turned(again).q.nan_to_num(1.0)), path)
    assert io.load(path).valid.all(), "complete rotations are not missing any more"
