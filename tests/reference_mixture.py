"""Oracle: three estimates of a motion mixed by Stein's risk, in plain NumPy loops.

Nothing here comes from the package.
"""

import math

import numpy as np
from reference import between, multiply, quaternion
from reference_low_rank import low_rank, starts_of
from reference_spectra import (
    beliefs,
    correlated_power,
    shrunk,
    summed_steps,
    window_starts,
)


def freedom_of_spectra(away, path, window, rho):
    """Of one joint ``(T, 3)``: how far each frame follows its own noise, summed over the axes."""
    size, starts = window_starts(len(path), window)
    noise = np.array(correlated_power(size, rho))
    total, weight = np.zeros(len(path)), np.zeros(len(path))
    for start in starts:
        part = slice(start, start + size)
        taper = np.array([math.sin(math.pi * (n + 0.5) / size) for n in range(size)])
        for axis in range(3):
            seen = path[part, axis] - path[part, axis].mean() + away[part, axis]
            follow, cosines = [], []
            for k in range(size):
                cosine = np.array([math.cos(math.pi * k * (n + 0.5) / size) for n in range(size)])
                cosines.append(cosine / np.linalg.norm(cosine))
            spectrum = np.array([cosine @ seen for cosine in cosines])
            gains, belief = beliefs(spectrum[None], noise)
            for k in range(size):
                mean = belief @ gains[:, k]
                spread = belief @ (gains[:, k] - mean) ** 2
                follow.append(noise[k] * mean + spectrum[k] ** 2 * spread)
            for k in range(size):
                total[part] += taper * cosines[k] ** 2 * follow[k]
        weight[part] += taper
    return total / weight


def freedom_of_low_rank(data, stack, rho):
    """Of trajectories ``(S, C)`` of mean 0: how far a channel follows its own noise, ``(S,)``."""
    size, channels = data.shape
    lags = min(stack, (size + 1) // 2)
    rows, columns = size - lags + 1, lags * channels
    hankel = np.array([np.concatenate(data[r : r + lags]) for r in range(rows)])
    longer, shorter = max(rows, columns), min(rows, columns)
    ratio = shorter / longer
    left, values, _ = np.linalg.svd(hankel, full_matrices=False)
    u = values**2 / longer
    gain, rise = np.zeros(shorter), np.zeros(shorter)
    for i in range(shorter):
        if u[i] > (1 + math.sqrt(ratio)) ** 2:
            root = math.sqrt((u[i] - ratio - 1) ** 2 - 4 * ratio)
            gain[i] = root / u[i]
            rise[i] = 2 * (u[i] - ratio - 1) / max(root, 0.1) - gain[i]
    free = sum(rise) + (longer - shorter) * sum(gain)
    for i in range(shorter):
        for j in range(shorter):
            if i != j:
                free += (gain[i] * u[i] - gain[j] * u[j]) / (u[i] - u[j])
    more = free / (columns * sum(gain)) if sum(gain) > 0 else 1.0
    kept = (left * gain) @ left.T
    smoother = np.zeros((size, size))
    for b in range(size):
        impulse = np.array([[float(r + lag == b) for lag in range(lags)] for r in range(rows)])
        answer = kept @ impulse
        for a in range(size):
            found = [answer[a - lag, lag] for lag in range(lags) if 0 <= a - lag < rows]
            smoother[a, b] = sum(found) / len(found)
    result = np.zeros(size)
    for a in range(size):
        for b in range(size):
            slope = more * (smoother[a, b] - smoother[a].mean()) + 1 / size
            result[a] += slope * rho ** abs(a - b)
    return result


def low_rank_estimate(away, path, stack, span, rho):
    """What to add to the path ``(T, C)``, and the freedom of a channel ``(T,)``."""
    frames, size = len(path), min(len(path), span)
    taper = np.array([math.sin(math.pi * (n + 0.5) / size) ** 2 for n in range(size)])
    move, follow, weight = np.zeros_like(path), np.zeros(frames), np.zeros(frames)
    for start in starts_of(frames, span):
        part = slice(start, start + size)
        seen = (path + away)[part]
        mean = seen.mean(0)
        estimate = mean + low_rank(seen - mean, stack)
        move[part] += taper[:, None] * (estimate - path[part])
        follow[part] += taper * freedom_of_low_rank(seen - mean, stack, rho)
        weight[part] += taper
    return move / weight[:, None], follow / weight


def mixed(estimates, data, trust):
    """Of values ``(T, J, 3)`` and freedoms ``(T, J)``, one after the other."""
    joints = data.shape[1]
    value, freedom = (np.array(x) for x in estimates[0])
    for other, others in estimates[1:]:
        falls, length = np.zeros(joints), np.zeros(joints)
        for j in range(joints):
            for t, w in enumerate(trust[:, j]):
                way = other[t, j] - value[t, j]
                more = w * (others[t, j] - freedom[t, j])
                falls[j] += w * ((data[t, j] - value[t, j]) @ way - more)
                length[j] += w * way @ way
        if not length.any():  # short sequences: one window is as the other
            continue
        sure = length / (length + 10)
        mean = sure @ np.clip(falls / length, 0, 1) / sure.sum()
        for j in range(joints):
            share = min(max((falls[j] + 10 * mean) / (length[j] + 10), 0), 1)
            share = math.floor(256 * share + 1 - (math.sqrt(5) - 1) / 2) / 256
            value[:, j] += share * (other[:, j] - value[:, j])
            freedom[:, j] += share * (others[:, j] - freedom[:, j])
    return value


def mixture(q, trust, sigma, rho, motion):
    """Unit quaternions ``(T, J, 4)``, each joint in one hemisphere, about ``motion``."""
    joints = q.shape[1]

    def away_from(motion, j):
        steps = [between(m, a) for m, a in zip(motion, q[:, j], strict=True)]
        return trust[:, j, None] * np.array(steps) / sigma[j]

    middle, axes = [], []
    for j in range(joints):
        path = summed_steps(motion[:, j]) / sigma[j]
        colour = correlated_power(min(len(q), 64), rho)
        move = shrunk(away_from(motion[:, j], j), path, 64, 3, colour, hops=2)
        steps = np.diff(path + move, axis=0)
        axes.append(np.linalg.eigh(steps.T @ steps)[1])
        turns = [quaternion(sigma[j] * v) for v in move]
        middle.append(np.array([multiply(m, v) for m, v in zip(motion[:, j], turns, strict=True)]))
    paths = np.stack([summed_steps(middle[j]) / sigma[j] for j in range(joints)], 1)
    aways = np.stack([away_from(middle[j], j) for j in range(joints)], 1)
    flat = (x.reshape(len(q), -1) for x in (aways, paths))
    move, follow = low_rank_estimate(*flat, 6, 64, rho)
    move = move.reshape(aways.shape)
    last = np.stack([move[:, j] @ axes[j] for j in range(joints)], 1)
    estimates = []
    for window in (40, 192):
        colour = correlated_power(min(len(q), window), rho)
        values, freedoms = [], []
        for j in range(joints):
            seen, known = aways[:, j] @ axes[j], paths[:, j] @ axes[j]
            values.append(shrunk(seen, known, window, 1, colour))
            freedoms.append(freedom_of_spectra(seen, known, window, rho))
        estimates.append((np.stack(values, 1), np.stack(freedoms, 1)))
    estimates.append((last, 3 * np.repeat(follow[:, None], joints, 1)))
    data = np.stack([aways[:, j] @ axes[j] for j in range(joints)], 1)
    move = mixed(estimates, data, trust)
    result = np.empty_like(q)
    for j in range(joints):
        for t, v in enumerate(move[:, j] @ axes[j].T):
            result[t, j] = multiply(middle[j][t], quaternion(sigma[j] * v))
    return result
