"""Oracle: singular values of Hankel matrices shrunk in plain NumPy loops, one stretch at a time.

Nothing here comes from the package.
"""

import math

import numpy as np
from reference import between, multiply, quaternion
from reference_spectra import rough_motion, summed_steps


def starts_of(frames, span):
    """Windows over every frame, two at least, symmetric in time."""
    beyond = frames - min(frames, span)
    half = math.ceil((beyond / (span // 2) + 1) / 2)
    ahead = [(i * beyond) // (2 * half - 1) for i in range(half)]
    return ahead + [beyond - start for start in reversed(ahead)]


def shrunk_value(y, ratio):
    if y <= 1 + math.sqrt(ratio):
        return 0.0
    return math.sqrt((y * y - ratio - 1) ** 2 - 4 * ratio) / y


def low_rank(data, stack):
    """Trajectories ``(S, C)`` of mean 0, shrunk as one Hankel matrix."""
    size, channels = data.shape
    lags = min(stack, (size + 1) // 2)
    rows = size - lags + 1
    hankel = np.array([np.concatenate(data[r : r + lags]) for r in range(rows)])
    longer, ratio = max(hankel.shape), min(hankel.shape) / max(hankel.shape)
    left, values, right = np.linalg.svd(hankel, full_matrices=False)
    unit = math.sqrt(longer)
    values = np.array([unit * shrunk_value(y / unit, ratio) for y in values])
    shrunk = (left * values) @ right
    total, count = np.zeros_like(data), np.zeros((size, 1))
    for row in range(rows):
        for lag in range(lags):
            total[row + lag] += shrunk[row, lag * channels : (lag + 1) * channels]
            count[row + lag] += 1
    return total / count


def low_rank_motion(q, trust, sigma, stack, span):
    """Unit quaternions ``(T, J, 4)``, each joint in one hemisphere, ``trust`` of 0 to 1."""
    frames, joints = trust.shape
    motion = [rough_motion(q[:, j], 4) for j in range(joints)]
    away, path = [], []
    for j in range(joints):
        steps = [between(m, a) for m, a in zip(motion[j], q[:, j], strict=True)]
        away.append(trust[:, j, None] * np.array(steps) / sigma[j])
        path.append(summed_steps(motion[j]) / sigma[j])
    seen, known = np.concatenate(away, 1) + np.concatenate(path, 1), np.concatenate(path, 1)
    size = min(frames, span)
    taper = np.array([[math.sin(math.pi * (n + 0.5) / size) ** 2] for n in range(size)])
    total, weight = np.zeros_like(seen), np.zeros((frames, 1))
    for start in starts_of(frames, span):
        part = slice(start, start + size)
        mean = seen[part].mean(0)
        estimate = mean + low_rank(seen[part] - mean, stack)
        total[part] += taper * (estimate - known[part])
        weight[part] += taper
    move = total / weight
    result = np.empty_like(q)
    for j in range(joints):
        for t in range(frames):
            turn = quaternion(sigma[j] * move[t, 3 * j : 3 * j + 3])
            result[t, j] = multiply(motion[j][t], turn)
    return result
