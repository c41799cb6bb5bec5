"""Real input with all its faults: video estimates, joint angles without markers, IMU tracks."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchquat import io, so3

__all__ = ["DATA", "Input", "imu", "markerless", "video"]

DATA = Path(__file__).parents[2] / "shared" / "data"
METHODS = (4, 5, 6, 7)
SENSOR_FILTERS = ("est_vqf_quat6D", "est_vqf_quat9D", "est_ahrs_madgwick9D")


class Input(NamedTuple):
    """One estimate, and the truth where there is one.

    Attributes:
        name: What it is called in the table.
        q: Unit quaternions ``(T, J, 4)``.
        frame_rate: Frames per second.
        truth: Unit quaternions ``(T, J, 4)``.
    """

    name: str
    q: Tensor
    frame_rate: float
    truth: Tensor | None


def video(data: Path) -> Iterator[Input]:
    """SMPL poses estimated from video; those with ``filter`` in their name were smoothed before."""
    for path in sorted((data / "estimates" / "smpl_video").glob("*.npz")):
        motion = io.load(path)
        name = path.stem.removeprefix("video_").removesuffix("_amass")
        yield Input(name, motion.q, motion.frame_rate, None)


def markerless(data: Path) -> Iterator[Input]:
    """Joint angles by RTMPose in several cameras, and by markers at the same time.

    Each angle is a hinge of its own. Angles that a pipeline does not give are left out.
    """
    folder = data / "estimates" / "markerless"
    for method in METHODS:
        for path in sorted((folder / f"Method{method}").glob("*.csv")):
            here = np.genfromtxt(path, delimiter=",", names=True)
            markers = np.genfromtxt(folder / "Markers" / path.name, delimiter=",", names=True)
            names = [
                name
                for name in here.dtype.names or ()
                if name != "Time" and np.isfinite(here[name]).all()
            ]
            inside = here["Time"] <= markers["Time"][-1]
            time = here["Time"][inside]
            found, true = (
                np.stack([np.interp(time, rows["Time"], rows[name]) for name in names], -1)
                for rows in (here, markers)
            )
            rate = 1.0 / float(np.median(np.diff(time)))
            task = path.stem.removesuffix("_participant_01")
            yield Input(f"Method{method} {task}", _hinges(found), rate, _hinges(true))


def imu(data: Path) -> Iterator[Input]:
    """Orientation of a sensor in the hand by three filters, and by cameras."""
    for path in sorted((data / "imu").glob("*.npz")):
        with np.load(path) as archive:
            rate = float(archive["sampling_rate"])
            truth = _scalar_last(archive["opt_quat"])
            for name in SENSOR_FILTERS:
                q = _scalar_last(archive[name])
                yield Input(name.removeprefix("est_"), _in_frame_of(q, truth), rate, truth)


def _hinges(angle: np.ndarray) -> Tensor:
    turn = torch.from_numpy(angle)
    zero = torch.zeros_like(turn)
    return so3.exp(torch.stack([turn, zero, zero], -1))


def _scalar_last(wxyz: np.ndarray) -> Tensor:
    return torch.from_numpy(wxyz[:, None, [1, 2, 3, 0]])


def _in_frame_of(q: Tensor, truth: Tensor) -> Tensor:
    """Turned in the world and on the body by two constants, so that it comes nearest to it.

    Both together are a rotation of the four components: an orthogonal Procrustes problem.
    """
    rows, wanted = _one_sign(q[:, 0]), _one_sign(truth[:, 0])
    left, _, right = torch.linalg.svd(rows.mT @ wanted)
    mirror = torch.ones_like(rows[0])
    mirror[-1] = torch.linalg.det(left @ right)
    return (rows @ (left * mirror) @ right)[:, None]


def _one_sign(q: Tensor) -> Tensor:
    """Every frame ``(T, 4)`` in the hemisphere of the frame before."""
    step = (q[1:] * q[:-1]).sum(-1)
    sign = torch.where(step < 0, -1.0, 1.0).to(q.dtype).cumprod(0)
    return torch.cat([q[:1], sign[:, None] * q[1:]])
