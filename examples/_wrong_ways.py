"""How pipelines smooth rotations without a thought for the sphere: to show the price, not for use.

Each takes quaternions ``(T, J, 4)`` as a NumPy array, float64, and gives the same. One more, the
components filtered and scaled to unit length again, is among the competitors in speed.
"""

import math

import numpy as np
from _competitors import components, smooth_matrices
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

__all__ = [
    "components",
    "integrated_increments",
    "logs_at_identity",
    "nine_entries",
    "rotation_vectors",
]

Array = np.ndarray


def rotation_vectors(q: Array, min_cutoff: float = 0.004, beta: float = 0.7) -> Array:
    """One-Euro filter on every entry of the rotation vectors by itself, as in VIBE.

    A rotation vector jumps by a whole turn where the angle passes pi, and the filter smears that.
    The defaults are VIBE's; cut-offs are in cycles per frame.
    """
    v = _logs(q)
    result, velocity = v.copy(), np.zeros_like(v[0])
    for frame in range(1, len(v)):
        velocity += _gain(1.0) * (v[frame] - result[frame - 1] - velocity)
        gain = _gain(min_cutoff + beta * np.abs(velocity))
        result[frame] = result[frame - 1] + gain * (v[frame] - result[frame - 1])
    return _exps(result)


def nine_entries(q: Array, radius: int = 3) -> Array:
    """Savitzky-Golay filter on the entries of the matrices, as in MMHuman3D.

    What comes out is no rotation; the nearest one is taken, by singular values.
    """
    left, _, right = np.linalg.svd(smooth_matrices(q, radius))
    handed = np.linalg.det(left @ right)  # -1 where the nearest orthogonal matrix is a mirror
    left[..., 2] *= handed[..., None]
    quaternions = np.asarray(Rotation.from_matrix((left @ right).reshape(-1, 3, 3)).as_quat())
    return quaternions.reshape(q.shape)


def logs_at_identity(q: Array, sigma_t: float = 1.0) -> Array:
    """Gaussian filter on the logarithms at the identity: right for small rotations only."""
    return _exps(gaussian_filter1d(_logs(q), sigma_t, axis=0))


def integrated_increments(q: Array, sigma_t: float = 1.0) -> Array:
    """Filter the steps from frame to frame and walk along them from the first, as Fang et al. 1998.

    Nothing pulls the walk back: what the filter takes off a step is missing from there on.
    """
    shape = (len(q) - 1, q.shape[1], 3)
    here, there = (Rotation.from_quat(part.reshape(-1, 4)) for part in (q[:-1], q[1:]))
    steps = np.asarray((here.inv() * there).as_rotvec()).reshape(shape)
    smooth = gaussian_filter1d(steps, sigma_t, axis=0)
    walk = [Rotation.from_quat(q[0])]
    for step in smooth:
        walk.append(walk[-1] * Rotation.from_rotvec(step))
    return np.stack([np.asarray(place.as_quat()) for place in walk])


def _gain(cutoff: float | Array) -> float | Array:
    rate = 2.0 * math.pi * cutoff
    return rate / (1.0 + rate)


def _logs(q: Array) -> Array:
    vectors = np.asarray(Rotation.from_quat(q.reshape(-1, 4)).as_rotvec())
    return vectors.reshape(*q.shape[:-1], 3)


def _exps(v: Array) -> Array:
    quaternions = np.asarray(Rotation.from_rotvec(v.reshape(-1, 3)).as_quat())
    return quaternions.reshape(*v.shape[:-1], 4)
