"""Oracle: wild samples found in plain NumPy loops, one joint, one frame, one neighbour at a time.

Nothing here comes from the package.
"""

import functools
import math

import numpy as np
from reference import between

REACH = 4
LEVELS = (1.0, 10.0, 100.0, 1e3, 1e4)
GUESSES = (
    {-1: 1 / 2, 1: 1 / 2},
    {-2: -1 / 6, -1: 2 / 3, 1: 2 / 3, 2: -1 / 6},
    {-2: -1.0, -1: 2.0},
    {1: 2.0, 2: -1.0},
    {-1: 2 / 3, 2: 1 / 3},
    {-2: 1 / 3, 1: 2 / 3},
    {-2: -1 / 3, -1: 1.0, 2: 1 / 3},
    {-2: 1 / 3, 1: 1.0, 2: -1 / 3},
)


def angle(a, b):
    return float(np.linalg.norm(between(a, b)))


@functools.cache
def covariance(lag):
    """Of a process with the spectrum 1 / (f0^2 + f^2)^3."""
    frequency = (np.arange(2000) + 0.5) / 4000
    return float(np.sum(np.cos(2 * math.pi * lag * frequency) / (0.01**2 + frequency**2) ** 3))


@functools.cache
def best_weights(lags, level):
    """Weights of the best linear prediction from some lags, and the squared error to expect."""

    def solved(lags, noise):
        among = np.array([[covariance(abs(a - b)) for b in lags] for a in lags])
        ahead = np.array([covariance(abs(a)) for a in lags])
        weights = np.linalg.solve(among + noise * np.eye(len(lags)), ahead)
        return weights, covariance(0) - weights @ ahead

    every = [lag for lag in range(-REACH, REACH + 1) if lag != 0]
    unit = solved(every, 0.0)[1]
    whole = solved(every, level * unit)[1] / unit + level
    if not lags:
        return np.zeros(0), (covariance(0) / unit + level) / whole
    weights, error = solved(lags, level * unit)
    return weights, (error / unit + level) / whole


def predicted(q, good, level):
    """Of every frame: what its good neighbours predict, and the squared error to expect."""
    rotations, variances = [], []
    for t in range(len(q)):
        lags = tuple(
            lag
            for lag in range(-REACH, REACH + 1)
            if lag != 0 and 0 <= t + lag < len(q) and good[t + lag]
        )
        weights, variance = best_weights(lags, level)
        mean = sum((w * q[t + lag] for w, lag in zip(weights, lags, strict=True)), np.zeros(4))
        norm = np.linalg.norm(mean)
        rotations.append(mean / norm if norm > 1e-3 else q[t])
        variances.append(variance)
    return np.array(rotations), np.array(variances)


def signs_chosen(q, good):
    chosen = [q[0]]
    last = q[0]
    for t in range(1, len(q)):
        here = q[t] if np.dot(q[t], last) >= 0 else -q[t]
        chosen.append(here)
        if good[t]:
            last = here
    return np.array(chosen)


def mean_of(values, good):
    kept = [v for v, g in zip(values, good, strict=True) if g]
    return sum(kept) / max(len(kept), 1)


def sizes(values, good):
    """Mean of the good ones within four frames, but itself; three times the whole one beside."""
    overall = mean_of([math.sqrt(v) for v in values], good) ** 2
    result = []
    for t in range(len(values)):
        near = [
            values[s] for s in range(max(t - 4, 0), min(t + 5, len(values))) if s != t and good[s]
        ]
        result.append((sum(near) + 3.0 * overall) / (len(near) + 3.0))
    return result


def first_guess(q, present, floor):
    error = []
    last = len(q) - 1
    for t in range(len(q)):
        off = [math.inf]
        for guess in GUESSES:
            places = [min(max(t + lag, 0), last) for lag in guess]
            if all(present[s] for s in places):
                mean = sum(w * q[s] for w, s in zip(guess.values(), places, strict=True))
                off.append(angle(mean / np.linalg.norm(mean), q[t]))
        error.append(min(off))
    known = [present[t] and math.isfinite(error[t]) for t in range(len(q))]
    root = [e if k else 0.0 for e, k in zip(error, known, strict=True)]
    size = [s**2 for s in sizes([math.sqrt(e) for e in root], known)]
    return [
        bool(present[t]) and not root[t] > 2.5 * math.hypot(size[t], floor) for t in range(len(q))
    ]


def noise_level(q, good):
    best = chosen = None
    for index, level in enumerate(LEVELS):
        guess, _ = predicted(q, good, level)
        off = [math.sqrt(angle(a, b)) for a, b in zip(guess, q, strict=True)]
        mean = mean_of(off, good) ** 2
        if best is None or mean < 0.98 * best:
            best, chosen = mean, index
    return chosen


def gap(q, good, t):
    """Angle between the good samples before and after."""
    before = [s for s in range(t - 1, t - REACH - 1, -1) if 0 <= s and good[s]]
    after = [s for s in range(t + 1, t + REACH + 1) if s < len(q) and good[s]]
    return angle(q[before[0]], q[after[0]]) if before and after else 0.0


def judged(q, present, good, level, floor, noise):
    guess, variance = predicted(q, good, LEVELS[level])
    error = [angle(a, b) for a, b in zip(guess, q, strict=True)]
    size = sizes([e**2 / v for e, v in zip(error, variance, strict=True)], good)
    limit, clear = [], []
    for s, v in zip(size, variance, strict=True):
        expected = math.sqrt((s + floor**2) * v)
        limit.append(expected * min(2.4 * (0.12 / expected) ** 0.4, 12.0))
        clear.append(max((2.0 if level >= 2 else 3.0) * limit[-1], 0.35))
    share = mean_of([float(e > c) for e, c in zip(error, clear, strict=True)], present)
    believed = min(max((share - 0.006) / 0.014, 0.0), 1.0)
    excess = []
    for t in range(len(q)):
        bound = max(limit[t], 0.05) ** believed * clear[t] ** (1.0 - believed)
        bound = max(bound, 3.0 * noise * math.sqrt(variance[t]), 0.5 * gap(q, good, t))
        excess.append(error[t] / bound)
    rated = [e if g else 0.0 for e, g in zip(excess, good, strict=True)]
    result = []
    for t in range(len(q)):
        largest = max(rated[max(t - 3, 0) : t + 4])
        wrong = rated[t] > 1.0 and rated[t] >= largest
        back = bool(present[t]) and not good[t] and excess[t] < 0.9
        result.append((good[t] and not wrong) or back)
    return result


def good_samples(q, present, sigma=0.0):
    """Which samples of one joint ``(T, 4)`` are neither missing nor wild; and the noise level."""
    noise = math.sqrt(3.0) * sigma
    floor = max(noise, 0.002)
    q = signs_chosen(q, present)
    good, level = first_guess(q, present, floor), 1
    for turn in range(5):
        q = signs_chosen(q, good)
        if turn == 1:
            level = noise_level(q, good)
        good = judged(q, present, good, level, floor, noise)
    return np.array(good), level
