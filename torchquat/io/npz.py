"""npz files: AMASS and SMPL poses, and a plain format that says what it holds."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from torchquat import so3
from torchquat.io._copies import PARTS, repeated, same
from torchquat.io._zip import Anything, Archive, pack, said
from torchquat.io.motion import FormatError, Motion
from torchquat.representation import continuous_rotvec
from torchquat.skeleton import Skeleton

__all__ = ["NpzSource", "new_npz", "read_npz"]

ORDERS = {"xyzw": [0, 1, 2, 3], "wxyz": [3, 0, 1, 2]}
"""Where the components of a file go from those of the package."""

FRAME_RATES = ("mocap_framerate", "mocap_frame_rate")


class _Layout(Protocol):
    """Where the rotations of an archive are."""

    def arrays(self, motion: Motion, before: Tensor) -> dict[str, Anything]:
        """The arrays that hold them, with the rotations of ``motion``."""
        ...


@dataclass(frozen=True, eq=False)
class NpzSource:
    """An npz archive as it was read.

    Attributes:
        archive: All entries, byte for byte.
        layout: Where the rotations are.
        q: The rotations that were read ``(T, J, 4)``.
    """

    archive: Archive
    layout: _Layout
    q: Tensor

    def render(self, motion: Motion) -> bytes:
        """The archive with the rotations of ``motion``: same keys, order and dtypes.

        Joints whose rotations did not change keep their numbers.

        Raises:
            ValueError: If the shape of the motion is not that of the file.
        """
        if motion.q.shape != self.q.shape:
            raise ValueError(
                f"q must have shape {tuple(self.q.shape)}, got {tuple(motion.q.shape)}."
            )
        return self.archive.rewritten(self.layout.arrays(motion, self.q))


def read_npz(path: Path) -> Motion:
    """Read an AMASS or SMPL file (key ``poses``) or a plain one (keys ``q`` and ``order``).

    Args:
        path: File to read. Object arrays are refused, never unpickled.

    Returns:
        Rotations and frame rate, with what the file has of names, skeleton, root and weights.

    Raises:
        FormatError: If the archive is unsound, or a key is missing or of a wrong shape or dtype.
        OSError: If the file cannot be read.
    """
    archive = Archive(path)
    if "q" in archive.keys:
        return _read_plain(archive)
    if "poses" in archive.keys:
        return _read_amass(archive)
    hint = ": use io.load_estimate" if "body_pose" in archive.keys else ""
    raise FormatError(f"{path}: expected the key 'poses' or 'q', got {archive.keys}{hint}")


def new_npz(motion: Motion) -> bytes:
    """A plain npz: quaternions with their order and frame rate by name, and the skeleton."""
    arrays: dict[str, Anything] = {
        "q": motion.q.numpy(),
        "order": np.array("xyzw"),
        "frame_rate": np.array(motion.frame_rate),
        "names": np.array(motion.names),
    }
    if motion.skeleton is not None:
        arrays["parents"] = np.array(motion.skeleton.parents)
        arrays["offsets"] = motion.skeleton.offsets.numpy()
        if motion.skeleton.end_sites:
            joints, places = zip(*motion.skeleton.end_sites, strict=True)
            arrays["end_site_parents"] = np.array(joints)
            arrays["end_site_offsets"] = np.array(places)
    if motion.root_position is not None:
        arrays["root_position"] = motion.root_position.numpy()
    if motion.weight is not None:
        arrays["weight"] = motion.weight.numpy()
    return pack(arrays)


@dataclass(frozen=True)
class _Plain:
    """Quaternions in the key ``q``."""

    stored: Anything
    order: str
    has_weight: bool

    def arrays(self, motion: Motion, before: Tensor) -> dict[str, Anything]:
        moved = motion.q.numpy()[..., ORDERS[self.order]].astype(self.stored.dtype)
        kept = (motion.q == before).all(-1).all(0)[:, None].numpy()
        arrays: dict[str, Anything] = {"q": np.where(kept, self.stored, moved)}
        if self.has_weight and motion.weight is None:  # complete now: nothing is missing
            arrays["weight"] = np.ones(motion.q.shape[:-1])
        return arrays


@dataclass(frozen=True)
class _Amass:
    """Rotation vectors in ``poses``, and in other keys that repeat parts of it."""

    stored: Anything
    parts: dict[str, tuple[int, int]]
    copies: dict[str, Anything]

    def arrays(self, motion: Motion, before: Tensor) -> dict[str, Anything]:
        frames, width = self.stored.shape
        if not frames:
            return {}
        stored = self.stored.astype(np.float64).reshape(frames, -1, 3)
        kept = (motion.q == before).all(-1).all(0)[:, None].numpy()
        solved = continuous_rotvec(motion.q, torch.from_numpy(stored[0])).numpy()
        poses = np.where(kept, stored, solved).reshape(frames, width)
        arrays: dict[str, Anything] = {"poses": poses.astype(self.stored.dtype)}
        for key, (start, stop) in self.parts.items():
            copy = self.copies[key]
            arrays[key] = poses[:, start:stop].reshape(copy.shape).astype(copy.dtype)
        return arrays


def _read_plain(archive: Archive) -> Motion:
    order = str(_get(archive, "order"))
    if order not in ORDERS:
        raise FormatError(f"{archive.path}: order: expected one of {list(ORDERS)}, got {order!r}")
    stored = _floats(archive, "q", 3)
    if stored.shape[-1] != 4:
        raise FormatError(f"{archive.path}: q: expected shape (T, J, 4), got {stored.shape}")
    frames, joints, _ = stored.shape
    q = torch.from_numpy(stored.astype(np.float64)[..., np.argsort(ORDERS[order])])

    names = tuple(f"joint_{index}" for index in range(joints))
    if "names" in archive.keys:
        names = tuple(str(name) for name in archive.array("names").reshape(-1))
    skeleton = weight = root_position = None
    try:
        if "parents" in archive.keys:
            skeleton = _read_skeleton(archive, names)
        if "weight" in archive.keys:
            weight = torch.from_numpy(_floats(archive, "weight", 2).astype(np.float64))
            weight = weight.expand(frames, joints)
        if "root_position" in archive.keys:
            root_position = torch.from_numpy(_floats(archive, "root_position", 2).astype(float))
            root_position = root_position.expand(frames, 3)
        return Motion(
            q=q,
            frame_rate=_number(archive, "frame_rate"),
            names=names,
            skeleton=skeleton,
            root_position=root_position,
            weight=weight,
            source=NpzSource(archive, _Plain(stored, order, weight is not None), q),
        )
    except FormatError:
        raise
    except (ValueError, RuntimeError) as error:
        raise FormatError(f"{archive.path}: {error}") from None


def _read_skeleton(archive: Archive, names: Sequence[str]) -> Skeleton:
    end_sites = ()
    if "end_site_parents" in archive.keys:
        joints = _whole_numbers(archive, "end_site_parents")
        places = _floats(archive, "end_site_offsets", 2).tolist()
        pairs = zip(joints, places, strict=True)
        end_sites = tuple((joint, (x, y, z)) for joint, (x, y, z) in pairs)
    return Skeleton(
        names=tuple(names),
        parents=tuple(_whole_numbers(archive, "parents")),
        offsets=torch.from_numpy(_floats(archive, "offsets", 2).astype(np.float64)),
        end_sites=end_sites,
    )


def _read_amass(archive: Archive) -> Motion:
    stored = _floats(archive, "poses", 2)
    frames, width = stored.shape
    if width % 3 or not width:
        raise FormatError(f"{archive.path}: poses: expected a width of 3 J, got {width}")
    rates = [key for key in FRAME_RATES if key in archive.keys]
    if not rates:
        raise FormatError(
            f"{archive.path}: expected {' or '.join(FRAME_RATES)}, got {archive.keys}: "
            "use io.load_estimate"
        )
    parts = {key: span for key, span in PARTS.get(width, {}).items() if key in archive.keys}
    for key, span in parts.items():
        _check_part(archive, key, stored[:, slice(*span)])
    parts |= repeated(stored, archive.keys, archive.array)
    copies = {key: archive.array(key) for key in parts}

    q = so3.exp(torch.from_numpy(stored.astype(np.float64)).reshape(frames, width // 3, 3))
    return Motion(
        q=q,
        frame_rate=_number(archive, rates[0]),
        names=tuple(f"joint_{index}" for index in range(width // 3)),
        root_position=_trans(archive, frames),
        source=NpzSource(archive, _Amass(stored, parts, copies), q),
    )


def _check_part(archive: Archive, key: str, part: Anything) -> None:
    """Raise unless a key repeats a part of ``poses``."""
    copy = _floats(archive, key, 2)
    if copy.shape != part.shape:
        raise FormatError(f"{archive.path}: {key}: expected shape {part.shape}, got {copy.shape}")
    if not same(copy, part):
        raise FormatError(f"{archive.path}: {key}: expected what 'poses' holds, got other values")


def _trans(archive: Archive, frames: int) -> Tensor | None:
    if "trans" not in archive.keys:
        return None
    trans = _floats(archive, "trans", 2)
    if trans.shape != (frames, 3):
        raise FormatError(f"{archive.path}: trans: expected ({frames}, 3), got {trans.shape}")
    return torch.from_numpy(trans.astype(np.float64))


def _get(archive: Archive, key: str) -> Anything:
    if key not in archive.keys:
        raise FormatError(f"{archive.path}: expected the key {key!r}, got {archive.keys}")
    return archive.array(key)


def _floats(archive: Archive, key: str, dimensions: int) -> Anything:
    array = _get(archive, key)
    if array.dtype.kind != "f" or array.ndim != dimensions:
        raise FormatError(
            f"{archive.path}: {key}: expected {dimensions} dimensions of floating-point numbers, "
            f"got {array.dtype} {array.shape}"
        )
    return array


def _whole_numbers(archive: Archive, key: str) -> list[int]:
    array = _get(archive, key)
    fits = array.ndim == 1 and array.dtype.kind in "fiu" and bool(np.isfinite(array).all())
    if not fits or (array != np.trunc(array)).any():
        raise FormatError(
            f"{archive.path}: {key}: expected one dimension of whole numbers, "
            f"got {array.dtype} {array.shape}"
        )
    return [int(number) for number in array]


def _number(archive: Archive, key: str) -> float:
    array = _get(archive, key)
    number = float(array.reshape(-1)[0]) if array.size == 1 and array.dtype.kind in "fiu" else 0.0
    if not 0 < number < float("inf"):
        raise FormatError(f"{archive.path}: {key}: expected frames per second, got {said(array)}")
    return number
