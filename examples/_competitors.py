"""What people filter rotations with today, as they do it: for benchmarks, not for use.

Each takes quaternions ``(T, J, 4)`` as a NumPy array, float64, and gives the same.
"""

import math
from collections.abc import Callable
from typing import cast

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

__all__ = ["COMPETITORS", "SLOW", "components", "smooth_matrices", "smooth_net"]

Array = np.ndarray
WINDOW = 32


def components(q: Array, sigma_t: float = 1.0) -> Array:
    """Gaussian filter on the components, scaled to unit length again."""
    smooth = gaussian_filter1d(q, sigma_t, axis=0)
    return smooth / np.linalg.norm(smooth, axis=-1, keepdims=True)


def savitzky_golay(q: Array) -> Array:
    """Savitzky-Golay filter on the components, scaled to unit length again."""
    smooth = cast(Array, savgol_filter(q, 7, 2, axis=0))
    return smooth / np.linalg.norm(smooth, axis=-1, keepdims=True)


def nine_entries(q: Array) -> Array:
    """Matrices filtered entry by entry and made quaternions again, as in MMHuman3D."""
    smooth = smooth_matrices(q).reshape(-1, 3, 3)
    return np.asarray(Rotation.from_matrix(smooth).as_quat()).reshape(q.shape)


def smooth_matrices(q: Array, radius: int = 3) -> Array:
    """Savitzky-Golay filter on the entries of rotation matrices ``(T, J, 3, 3)``."""
    matrices = np.asarray(Rotation.from_quat(q.reshape(-1, 4)).as_matrix())
    entries = matrices.reshape(*q.shape[:2], 9)
    width = 2 * min(radius, (len(q) - 1) // 2) + 1  # not longer than the sequence
    smooth = cast(Array, savgol_filter(entries, width, min(2, width - 1), axis=0))
    return smooth.reshape(*q.shape[:2], 3, 3)


def windowed_mean(q: Array, radius: int = 3) -> Array:
    """Gaussian mean of every window by ``scipy.spatial.transform.Rotation.mean``."""
    weights = np.exp(-0.5 * np.arange(-radius, radius + 1) ** 2)
    padded = np.pad(q, ((radius, radius), (0, 0), (0, 0)), mode="reflect")
    result = np.empty_like(q)
    for frame in range(len(q)):
        for joint in range(q.shape[1]):
            window = Rotation.from_quat(padded[frame : frame + 2 * radius + 1, joint])
            result[frame, joint] = np.asarray(window.mean(weights).as_quat())
    return result


def pseudo_code(q: Array, radius: int = 3, sigma_g: float = 0.3) -> Array:
    """Courty's algorithm 1 in loops over frames and neighbours, one joint after the other."""
    result = np.empty_like(q)
    frames = len(q)
    for joint in range(q.shape[1]):
        track = [tuple(row) for row in q[:, joint].tolist()]
        for i in range(frames):
            total, step = 0.0, [0.0, 0.0, 0.0]
            for lag in range(-radius, radius + 1):
                other = track[min(max(i + lag, 0), frames - 1)]
                v = _log(_relative(track[i], other))
                square = v[0] ** 2 + v[1] ** 2 + v[2] ** 2
                m = math.exp(-0.5 * lag**2 - 0.5 * square / sigma_g**2)
                total += m
                step = [s + m * c for s, c in zip(step, v, strict=True)]
            result[i, joint] = _turned(track[i], [s / total for s in step])
    return result


def numpy_loops(q: Array, radius: int = 3, sigma_g: float = 0.3) -> Array:
    """The same as it is written down in NumPy, a small array for every quaternion."""
    result = np.empty_like(q)
    last = len(q) - 1
    for i, joint in np.ndindex(*q.shape[:2]):
        here = q[i, joint]
        total, step = 0.0, np.zeros(3)
        for lag in range(-radius, radius + 1):
            other = q[min(max(i + lag, 0), last), joint]
            v = _numpy_log(here, other)
            m = np.exp(-0.5 * lag**2) * np.exp(-0.5 * (v @ v) / sigma_g**2)
            total, step = total + m, step + m * v
        angle = np.linalg.norm(step / total)
        axis = step / np.linalg.norm(step) if np.linalg.norm(step) > 0 else step
        result[i, joint] = _numpy_product(
            here, np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))
        )
    return result


def _numpy_log(a: Array, b: Array) -> Array:
    relative = _numpy_product(a * [-1, -1, -1, 1], b)
    relative = relative if relative[3] >= 0 else -relative
    sine = np.linalg.norm(relative[:3])
    return 2 * np.arctan2(sine, relative[3]) * relative[:3] / sine if sine > 0 else np.zeros(3)


def _numpy_product(a: Array, b: Array) -> Array:
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])


def smooth_net(joints: int) -> Callable[[Tensor], Tensor]:
    """A network of the shape of SmoothNet: every channel by itself, windows of 32 frames.

    512 wide, three residual blocks, random weights: only its speed is of interest.
    """

    class Residual(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.path = nn.Sequential(
                nn.Linear(512, 256), nn.LeakyReLU(0.2), nn.Linear(256, 512), nn.LeakyReLU(0.2)
            )

        def forward(self, x: Tensor) -> Tensor:
            return x + self.path(x)

    network = nn.Sequential(
        nn.Linear(WINDOW, 512),
        nn.LeakyReLU(0.1),
        *(Residual() for _ in range(3)),
        nn.Linear(512, WINDOW),
    )

    def run(q: Tensor) -> Tensor:
        """Windows side by side, the cheapest way: SmoothNet itself averages overlapping ones."""
        whole = len(q) // WINDOW * WINDOW
        channels = q[:whole].reshape(whole, joints * 4)
        windows = channels.unfold(0, WINDOW, WINDOW)  # (T / 32, channels, 32)
        batches = [network(windows[start : start + 8]) for start in range(0, len(windows), 8)]
        smooth = torch.cat(batches).movedim(-1, 1).reshape(whole, *q.shape[1:])
        return torch.cat([smooth, q[whole:]])

    return run


Numbers = tuple[float, float, float, float]


def _relative(a: Numbers, b: Numbers) -> Numbers:
    ax, ay, az, aw = -a[0], -a[1], -a[2], a[3]
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _log(q: Numbers) -> list[float]:
    sign = -1.0 if q[3] < 0 else 1.0
    sine = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    factor = 2.0 * math.atan2(sine, sign * q[3]) / sine if sine > 0 else 2.0
    return [sign * factor * c for c in q[:3]]


def _turned(q: Numbers, v: list[float]) -> Numbers:
    angle = math.sqrt(sum(c**2 for c in v))
    factor = math.sin(angle / 2) / angle if angle > 0 else 0.5
    turn = (factor * v[0], factor * v[1], factor * v[2], math.cos(angle / 2))
    return _relative((-q[0], -q[1], -q[2], q[3]), turn)


COMPETITORS: dict[str, Callable[[Array], Array]] = {
    "scipy gaussian_filter1d, components": components,
    "scipy savgol_filter, components": savitzky_golay,
    "nine matrix entries and back": nine_entries,
}
SLOW: dict[str, Callable[[Array], Array]] = {
    "Rotation.mean of every window": windowed_mean,
    "Courty's pseudo-code in loops": pseudo_code,
    "Courty's pseudo-code in NumPy loops": numpy_loops,
}
