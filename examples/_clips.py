"""Clips that the papers' examples work on: from files, or made here where there are none."""

import math
from pathlib import Path

import torch
from torch import Tensor

from torchquat import Skeleton, fill_missing, io, so3
from torchquat.io import Motion

__all__ = ["CMU", "middle", "moving_joints", "synthetic_arm", "synthetic_run"]

CMU = Path(__file__).parents[2] / "shared" / "data" / "cmu"
"""Clips of the CMU motion capture database, where they lie beside the project."""

_FINGERS = ("finger", "thumb", "index", "middle", "ring", "pinky")


def middle(path: Path, frames: int, *, frame_rate: float | None = None, skip: int = 0) -> Motion:
    """Frames from the middle of a clip, missing ones filled.

    Args:
        path: BVH or npz file.
        frames: How many, at most; all if the clip is shorter.
        frame_rate: Thinned out to about this [1/s]; ``None``: as recorded.
        skip: Leading frames that are not part of the motion, such as a T-pose.

    Returns:
        The motion, without what only its file needs.

    Raises:
        ValueError: If nothing is left.
    """
    motion = io.load(path)
    step = 1 if frame_rate is None else max(round(motion.frame_rate / frame_rate), 1)
    length = min(frames * step, len(motion.q) - skip)
    if length < 1:
        raise ValueError(f"{path}: expected more than {skip} frames, got {len(motion.q)}.")
    start = (skip + len(motion.q) - length) // 2
    filled = fill_missing(motion.q, motion.weight)[start : start + length : step]
    return Motion(filled, motion.frame_rate / step, motion.names, skeleton=motion.skeleton)


def moving_joints(motion: Motion) -> Motion:
    """The joints that turn by more than a degree, fingers left out; without a skeleton."""
    range_of_motion = so3.distance(motion.q, motion.q[:1]).amax(0)
    kept = [
        joint
        for joint, name in enumerate(motion.names)
        if range_of_motion[joint] > math.radians(1.0)
        and not any(finger in name.lower() for finger in _FINGERS)
    ]
    return Motion(motion.q[:, kept], motion.frame_rate, tuple(motion.names[j] for j in kept))


def synthetic_arm(frames: int = 150, frame_rate: float = 60.0) -> Motion:
    """An arm that swings widely, and beats quickly with the forearm in between."""
    time = torch.arange(frames, dtype=torch.float64)[:, None] / frame_rate
    swing = 0.9 * torch.sin(2 * math.pi * 0.6 * time)
    beat = 0.35 * torch.sin(2 * math.pi * 5.0 * time) * torch.exp(-(((time - 1.4) / 0.25) ** 2))
    arm = torch.cat([0.5 * swing, 0.3 * swing.square(), swing], -1)
    forearm = torch.cat([0.1 * swing, 0.8 + 0.5 * swing + beat, 0.4 * beat], -1)
    hand = torch.cat([0.3 * swing, beat, 0.2 * swing], -1)
    names = ("RightArm", "RightForeArm", "RightHand")
    offsets = torch.tensor([[0.0, 1.4, 0.0], [-0.3, 0.0, 0.0], [-0.25, 0.0, 0.0]])
    skeleton = Skeleton(names, (-1, 0, 1), offsets.double(), (((2, (-0.1, 0.0, 0.0))),))
    return Motion(so3.exp(torch.stack([arm, forearm, hand], -2)), frame_rate, names, skeleton)


def synthetic_run(frames: int = 240, frame_rate: float = 120.0) -> Motion:
    """Arms and legs of someone who runs: half turned against each other, feet that hit the ground.

    Three steps a second; the amplitudes are those of a jog, by eye.
    """
    phase = 2 * math.pi * 1.5 * torch.arange(frames, dtype=torch.float64) / frame_rate
    joints = {}
    for side, shift in (("Left", 0.0), ("Right", math.pi)):
        leg, arm = phase + shift, phase + shift + math.pi
        impact = 0.15 * torch.exp(6.0 * (torch.cos(leg - 1.2) - 1.0))
        joints[f"{side}UpLeg"] = _vector(0.7 * leg.sin(), 0.05 * leg.cos(), 0.08 * leg.sin())
        joints[f"{side}Leg"] = _vector(-0.9 - 0.7 * (leg + 1.0).sin(), 0.0 * leg, 0.0 * leg)
        joints[f"{side}Foot"] = _vector(0.3 * leg.cos() - impact, 0.1 * leg.sin(), impact)
        joints[f"{side}Arm"] = _vector(0.5 * arm.sin(), 0.1 * arm.cos(), 1.1 + 0.1 * arm.sin())
        joints[f"{side}ForeArm"] = _vector(0.1 * arm.cos(), 1.4 + 0.3 * arm.sin(), 0.0 * arm)
    joints["Hips"] = _vector(0.05 * (2 * phase).sin(), 0.15 * phase.sin(), 0.03 * phase.cos())
    joints["Spine"] = _vector(0.08 * (2 * phase).cos(), -0.2 * phase.sin(), 0.04 * phase.sin())
    return Motion(so3.exp(torch.stack(list(joints.values()), -2)), frame_rate, tuple(joints))


def _vector(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    return torch.stack([x, y, z], -1)
