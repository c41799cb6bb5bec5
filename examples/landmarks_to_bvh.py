"""Turn the 3-D landmarks of MediaPipe Pose into joint rotations of a small skeleton.

python examples/landmarks_to_bvh.py LANDMARKS.npz --output MOTION.npz

The input holds landmarks ``(T, 33, 4)``: x to the right, y down, z away from the camera [m], and a
visibility in [0, 1]; NaN where nobody was found. An output ``.npz`` keeps those frames as missing;
BVH has no missing frames, so there they are filled.
"""

import sys
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import jsonargparse
import numpy as np
import roma
import torch
from _command import run
from torch import Tensor

from torchquat import Skeleton, fill_missing, io, so3
from torchquat.io import Motion

# Landmarks of MediaPipe Pose; two of them stand for the point halfway.
HIPS, SHOULDERS, EARS = (23, 24), (11, 12), (7, 8)
LEFT = {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27}
RIGHT = {name: index + 1 for name, index in LEFT.items()}

# At rest the figure stands upright in a T-pose and faces +z, its left hand towards +x.
# Normals are those of a flexed limb: elbows bend forward, knees backward.
UP = (0.0, 1.0, 0.0)
OUT = {"Left": (1.0, 0.0, 0.0), "Right": (-1.0, 0.0, 0.0)}
ELBOW = {"Left": (0.0, -1.0, 0.0), "Right": (0.0, 1.0, 0.0)}
DOWN, KNEE = (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)

NAMES = ("Hips", "Spine", "Chest", "Neck")
NAMES += ("LeftArm", "LeftForeArm", "RightArm", "RightForeArm")
NAMES += ("LeftUpLeg", "LeftLeg", "RightUpLeg", "RightLeg")
PARENTS = (-1, 0, 1, 2, 2, 4, 2, 6, 0, 8, 0, 10)

# Bends [rad] between which a limb's own plane takes over its twist from the joint above.
STRAIGHT, BENT = np.deg2rad(15.0), np.deg2rad(60.0)


def motion_from_landmarks(
    landmarks: Tensor, frame_rate: float, min_visibility: float = 0.0
) -> Motion:
    """Joint rotations that put every bone in the direction in which it was seen.

    Args:
        landmarks: ``(T, 33, 4)`` as MediaPipe gives them: x, y, z [m], visibility.
        frame_rate: Frames per second.
        min_visibility: Joints whose landmarks are seen less surely are missing.

    Returns:
        A motion of 12 joints, y upwards. Its weights are the visibilities: that of a joint is the
        least among the landmarks it needs. Rotations are NaN and weights 0 where a landmark is.

    Raises:
        ValueError: If the shape is another, or no frame holds a person.
    """
    if landmarks.dim() != 3 or landmarks.shape[1:] != (33, 4):
        raise ValueError(f"landmarks must have shape (T, 33, 4), got {tuple(landmarks.shape)}.")
    landmarks = landmarks.double()
    points = landmarks[..., :3] * landmarks.new_tensor([1.0, -1.0, -1.0])  # y up, z to the camera
    if not bool(points.isfinite().all(-1).all(-1).any()):
        raise ValueError("landmarks must hold a person in some frame, got none.")
    world = torch.stack(_world_rotations(points), -2)
    parents = [max(parent, 0) for parent in PARENTS]
    local = so3.relative(world[..., parents, :], world)
    local[..., 0, :] = world[..., 0, :]

    weight = _confidence(landmarks)
    weight = torch.where(local.isfinite().all(-1) & (weight >= min_visibility), weight, 0.0)
    local = torch.where(weight[..., None] > 0, local, torch.nan)
    return Motion(local, frame_rate, NAMES, skeleton=_skeleton(points), weight=weight)


def _world_rotations(points: Tensor) -> list[Tensor]:
    """World rotations ``(T, 4)`` of all joints."""
    across_hips = points[:, HIPS[0]] - points[:, HIPS[1]]
    across_shoulders = points[:, SHOULDERS[0]] - points[:, SHOULDERS[1]]
    across_ears = points[:, EARS[0]] - points[:, EARS[1]]
    torso = _middle(points, SHOULDERS) - _middle(points, HIPS)
    head = _middle(points, EARS) - _middle(points, SHOULDERS)

    hips = _two_axes(OUT["Left"], across_hips, UP, torso)
    spine = _two_axes(UP, torso, OUT["Left"], across_shoulders)
    chest = _two_axes(OUT["Left"], across_shoulders, UP, torso)
    neck = _two_axes(UP, head, OUT["Left"], across_ears)
    rotations = [hips, spine, chest, neck]
    for side, index in (("Left", LEFT), ("Right", RIGHT)):
        chain = points[:, [index["shoulder"], index["elbow"], index["wrist"]]]
        rotations += _limb(chest, chain, OUT[side], ELBOW[side])
    for index in (LEFT, RIGHT):
        chain = points[:, [index["hip"], index["knee"], index["ankle"]]]
        rotations += _limb(hips, chain, DOWN, KNEE)
    return rotations


def _limb(
    parent: Tensor, chain: Tensor, rest: Sequence[float], rest_normal: Sequence[float]
) -> list[Tensor]:
    """World rotations of both bones of a limb; the twist comes from the plane they span.

    The plane of a straight limb is noise: there the twist is that of the shortest turn from the
    parent's rest pose, and in between the two are mixed by the bend.
    """
    upper, lower = _unit(chain[:, 1] - chain[:, 0]), _unit(chain[:, 2] - chain[:, 1])
    swing = so3.compose(parent, _shortest_turn(rest, so3.rotate(so3.inverse(parent), upper)))
    carried = so3.rotate(swing, upper.new_tensor(rest_normal))
    plane = torch.linalg.cross(upper, lower)

    bend = torch.atan2(plane.norm(dim=-1), (upper * lower).sum(-1))
    share = ((bend - STRAIGHT) / (BENT - STRAIGHT)).clamp(0.0, 1.0)
    twist = torch.atan2(
        (torch.linalg.cross(carried, plane) * upper).sum(-1), (carried * plane).sum(-1)
    )
    turn = so3.exp((share * share * (3.0 - 2.0 * share) * twist)[..., None] * upper)
    first = so3.compose(turn, swing)
    # the lower bone follows on the shortest arc: about the plane's normal where it counts
    direction = so3.rotate(so3.inverse(first), lower)
    return [first, so3.compose(first, _shortest_turn(rest, direction))]


def _two_axes(
    rest: Sequence[float], seen: Tensor, rest_second: Sequence[float], second: Tensor
) -> Tensor:
    """The rotation that takes ``rest`` to ``seen``, and ``rest_second`` as near as it can."""
    before = _basis(seen.new_tensor(rest), seen.new_tensor(rest_second))
    matrix = _basis(seen, second) @ before.mT
    missing = ~matrix.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
    q = roma.rotmat_to_unitquat(torch.where(missing, torch.eye(3).to(matrix), matrix))
    return torch.where(missing[..., 0], torch.nan, q)


def _basis(first: Tensor, second: Tensor) -> Tensor:
    """Orthonormal columns: along ``first``, towards ``second``, and across both."""
    first = _unit(first)
    across = _unit(torch.linalg.cross(first, second))
    return torch.stack([first, torch.linalg.cross(across, first), across], -1)


def _shortest_turn(start: Sequence[float], end: Tensor) -> Tensor:
    """The rotation on the shortest arc from one unit vector to another."""
    origin = end.new_tensor(start).expand_as(end)
    cosine = (origin * end).sum(-1, keepdim=True)
    q = torch.cat([torch.linalg.cross(origin, end), 1.0 + cosine], -1)
    return torch.where(end.isfinite().all(-1, keepdim=True), so3.normalize(q), torch.nan)


def _skeleton(points: Tensor) -> Skeleton:
    """Offsets of the T-pose: bones as long as the median over all frames, both sides alike."""

    def length(start: Tensor, end: Tensor) -> float:
        return float((end - start).norm(dim=-1).nanmedian())

    def bone(start: str, end: str) -> float:
        both = [length(points[:, side[start]], points[:, side[end]]) for side in (LEFT, RIGHT)]
        return sum(both) / 2

    hip = length(points[:, HIPS[0]], points[:, HIPS[1]]) / 2
    shoulder = length(points[:, SHOULDERS[0]], points[:, SHOULDERS[1]]) / 2
    torso = length(_middle(points, HIPS), _middle(points, SHOULDERS))
    neck = length(_middle(points, SHOULDERS), _middle(points, EARS))
    upper_arm, forearm = bone("shoulder", "elbow"), bone("elbow", "wrist")
    thigh, shin = bone("hip", "knee"), bone("knee", "ankle")
    offsets = [(0.0, thigh + shin, 0.0), (0.0, 0.0, 0.0), (0.0, torso, 0.0), (0.0, 0.0, 0.0)]
    end_sites = [(3, (0.0, neck, 0.0))]
    for joint, x in ((4, 1.0), (6, -1.0)):
        offsets += [(x * shoulder, 0.0, 0.0), (x * upper_arm, 0.0, 0.0)]
        end_sites.append((joint + 1, (x * forearm, 0.0, 0.0)))
    for joint, x in ((8, 1.0), (10, -1.0)):
        offsets += [(x * hip, 0.0, 0.0), (0.0, -thigh, 0.0)]
        end_sites.append((joint + 1, (0.0, -shin, 0.0)))
    return Skeleton(
        NAMES, PARENTS, torch.tensor(offsets, dtype=torch.float64), end_sites=tuple(end_sites)
    )


def _confidence(landmarks: Tensor) -> Tensor:
    """Visibility ``(T, 12)``: the least among the landmarks that a rotation depends on.

    A rotation is measured against its parent's, but does not inherit the parent's doubt: a filter
    would punish every joint for a hip.
    """
    seen = landmarks[..., 3].nan_to_num(0.0).clamp(0.0, 1.0)

    def least(*indices: int) -> Tensor:
        return seen[:, list(indices)].amin(-1)

    columns = [least(*HIPS, *SHOULDERS)] * 3 + [least(*SHOULDERS, *EARS)]
    for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
        for side in (LEFT, RIGHT):
            columns += [least(*(side[name] for name in limb))] * 2
    return torch.stack(columns, -1)


def _middle(points: Tensor, pair: tuple[int, int]) -> Tensor:
    return (points[:, pair[0]] + points[:, pair[1]]) / 2


def _unit(v: Tensor) -> Tensor:
    """Unit vectors; NaN for those without a direction."""
    return v / v.norm(dim=-1, keepdim=True)


def _read(path: Path, key: str) -> tuple[Tensor, float]:
    """Landmarks and frame rate of an npz file."""
    try:
        with path.open("rb") as stream:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("one array")
            arrays = {wanted: file[wanted] for wanted in (key, "fps") if wanted in file.files}
    except (ValueError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path}: expected an npz archive, got {error}") from None
    for wanted in (key, "fps"):
        if wanted not in arrays:
            raise ValueError(f"{path}: expected the key {wanted!r}, got {file.files}")
        if arrays[wanted].dtype.kind not in "fiu":
            raise ValueError(f"{path}: {wanted}: expected numbers, got {arrays[wanted].dtype}")
    if arrays["fps"].size != 1:
        raise ValueError(f"{path}: fps: expected one number, got {arrays['fps'].shape}")
    return torch.from_numpy(arrays[key].astype(np.float64)), float(arrays["fps"].reshape(-1)[0])


def _convert(arguments: jsonargparse.Namespace) -> int:
    output: Path = arguments.output
    if output.exists() and not arguments.overwrite:
        raise ValueError(f"{output}: exists; --overwrite replaces it")
    landmarks, frame_rate = _read(arguments.landmarks, arguments.key)
    motion = motion_from_landmarks(landmarks, frame_rate, arguments.min_visibility)
    missing = ~motion.valid
    note = "kept as missing"
    if output.suffix.lower() == ".bvh":
        motion = motion.with_rotations(fill_missing(motion.q, motion.weight))
        note = "filled, for BVH has none"
    output.parent.mkdir(parents=True, exist_ok=True)
    io.save(motion, output)
    print(
        f"{output}: {len(motion.q)} frames at {frame_rate:g} fps, {len(NAMES)} joints; "
        f"{int(missing.all(-1).sum())} frames without anybody and {int(missing.sum())} of "
        f"{missing.numel()} joint samples missing: {note}"
    )
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Convert one file; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Turn MediaPipe landmarks into joint rotations.", exit_on_error=False
    )
    parser.add_argument("landmarks", type=Path, help="npz with landmarks (T, 33, 4) and fps")
    parser.add_argument("--output", type=Path, required=True, help="a name in .npz or .bvh")
    parser.add_argument("--key", default="world_raw", help="key of the landmarks")
    parser.add_argument("--min_visibility", type=float, default=0.0, help="less is missing")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing output")
    return run(parser, argv, _convert)


if __name__ == "__main__":
    sys.exit(main())
