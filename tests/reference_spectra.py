"""Oracle: local spectra in plain NumPy loops, one joint, one window, one channel at a time.

Nothing here comes from the package.
"""

import itertools
import math

import numpy as np
from reference import between, multiply, quaternion


def rough_motion(q, radius):
    path = []
    for t in range(len(q)):
        near = q[max(t - radius, 0) : t + radius + 1]
        mean = np.mean([np.outer(a, a) for a in near], 0)
        ahead = np.linalg.matrix_power(mean / np.trace(mean), 16) @ q[t]
        path.append(ahead / np.linalg.norm(ahead))
    return np.array(path)


def summed_steps(motion):
    path = [np.zeros(3)]
    for before, after in itertools.pairwise(motion):
        path.append(path[-1] + between(before, after))
    return np.array(path)


def window_starts(frames, window, hops=4):
    size, hop = min(frames, window), max(window // hops, 1)
    beyond = frames - size
    if beyond == 0:
        return size, [0]
    half = math.ceil(beyond / (2 * hop)) + 1
    ahead = [(i * beyond) // (2 * half - 1) for i in range(half)]
    return size, ahead + [beyond - start for start in reversed(ahead)]


def correlated_power(size, rho):
    """Of noise with ``rho**lag``, in every cosine: ``b^T C b``."""
    power = []
    for k in range(size):
        b = np.array([math.cos(math.pi * k * (n + 0.5) / size) for n in range(size)])
        covariance = [[rho ** abs(i - j) for i in range(size)] for j in range(size)]
        power.append(b @ np.array(covariance) @ b / (b @ b))
    return power


def beliefs(spectra, colour=None):
    """For channels with a common prior, ``(channels, W)``: gains of every prior, and odds.

    ``colour`` is the power of the noise in each coefficient, 1 if it is white.
    """
    size = spectra.shape[1]
    noise = [1.0] * size if colour is None else colour
    gains, scores = [], []
    for steepness in (2, 3, 4, 5, 6):
        for level in range(-4, 21, 2):
            frequency = [max(64.0 * k / size, 0.5) for k in range(size)]
            prior = [1e6] + [math.exp(level) * f**-steepness for f in frequency[1:]]
            score = 0.0
            for channel in spectra:
                for power, n, y in zip(prior, noise, channel, strict=True):
                    score -= 0.5 * (math.log(power + n) + y * y / (power + n))
            gains.append([p / (p + n) for p, n in zip(prior, noise, strict=True)])
            scores.append(score)
    belief = np.exp(np.array(scores) - max(scores))
    return np.array(gains), belief / belief.sum()


def wiener_gains(spectra, colour=None):
    """For channels with a common prior, ``(channels, W)``: the gain of every coefficient."""
    gains, belief = beliefs(spectra, colour)
    return belief @ gains


def shrunk(away, path, window, together, colour=None, hops=4):
    """What to add to the path; all in units of the noise, ``(T, 3)``."""
    frames = len(path)
    size, starts = window_starts(frames, window, hops)
    total, weight = np.zeros((frames, 3)), np.zeros((frames, 1))
    basis = np.array(
        [[math.cos(math.pi * k * (n + 0.5) / size) for n in range(size)] for k in range(size)]
    )
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    taper = np.array([[math.sin(math.pi * (n + 0.5) / size)] for n in range(size)])
    for start in starts:
        part = slice(start, start + size)
        known = path[part] - path[part].mean(0)
        spectra = (basis @ (known + away[part])).T
        groups = [[0, 1, 2]] if together == 3 else [[0], [1], [2]]
        for group in groups:
            gain = wiener_gains(spectra[group], colour)
            for channel in group:
                change = basis.T @ (gain * spectra[channel]) - known[:, channel]
                total[part, channel] += taper[:, 0] * change
        weight[part] += taper
    return total / weight


def local_spectrum(q, trust, sigma, window, rho=0.0):
    """Unit quaternions ``(T, 4)`` in one hemisphere, ``trust`` of 0 to 1 a frame."""
    colour = correlated_power(min(len(q), window), rho)
    motion = rough_motion(q, 4)

    def away_from(motion):
        return np.array([w * between(m, a) for w, m, a in zip(trust, motion, q, strict=True)])

    path = summed_steps(motion) / sigma
    move = shrunk(away_from(motion) / sigma, path, window, 3, colour)
    steps = np.diff(path + move, axis=0)
    _, axes = np.linalg.eigh(steps.T @ steps)
    turned = [multiply(m, quaternion(sigma * v)) for m, v in zip(motion, move, strict=True)]
    motion = np.array(turned)
    path = summed_steps(motion) / sigma
    move = shrunk(away_from(motion) / sigma @ axes, path @ axes, window, 1, colour) @ axes.T
    turned = [multiply(m, quaternion(sigma * v)) for m, v in zip(motion, move, strict=True)]
    return np.array(turned)
