"""Oracle: filters that people use today, in plain NumPy loops, one sequence ``(T, 4)`` at a time.

Nothing here comes from the package. One-axis motion has oracles of its own in the tests: scipy, and
least squares over the whole sequence.
"""

import math

import numpy as np
from reference import between, fill, linear_filter, multiply, prepare, quaternion, window_at


def turned(q, v):
    return multiply(q, quaternion(v))


def savitzky_golay(q, radius, order):
    """Ends from the outermost polynomials; ``numpy.polyfit`` on the path of every window."""
    frames = len(q)
    unit, _ = prepare(q, np.ones(frames), causal=False)
    steps = [between(unit[t], unit[t + 1]) for t in range(frames - 1)]
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, 0)])
    result = []
    for i in range(frames):
        middle = min(max(i, radius), frames - 1 - radius)
        places = np.arange(middle - radius, middle + radius + 1)
        fits = [
            np.polyval(np.polyfit(places - i, path[places, axis], order), 0.0) for axis in range(3)
        ]
        result.append(turned(unit[i], np.array(fits) - path[i]))
    return np.array(result)


def moving_mean(q, weight):
    unit, _ = prepare(q, weight, causal=False)
    result = linear_filter(q, weight, [4 / 24, 6 / 24, 4 / 24, 6 / 24, 4 / 24], "replicate")
    ends = [t for t in range(len(q)) if t < 2 or t >= len(q) - 2]
    result[ends] = unit[ends]
    return result


def median_of(window, weights, start, iterations):
    estimate = start
    if sum(weights) == 0:
        return estimate
    for iteration in range(iterations + 1):
        total, step = 0.0, np.zeros(3)
        for other, weight in zip(window, weights, strict=True):
            v = between(estimate, other)
            m = weight / math.sqrt(v @ v + 1e-6) if iteration else weight
            total, step = total + m, step + m * v
        estimate = turned(estimate, step / total)
    return estimate


def median(q, weight, radius, iterations=10, boundary="reflect"):
    unit, trust = prepare(q, weight, causal=False)
    return np.array(
        [
            median_of(*window_at(unit, trust, i, radius, boundary, False), unit[i], iterations)
            for i in range(len(unit))
        ]
    )


def hampel(q, weight, radius, n_sigmas, iterations=10, boundary="reflect"):
    unit, trust = prepare(q, weight, causal=False)
    middles = median(q, weight, radius, iterations, boundary)
    result = unit.copy()
    for i, middle in enumerate(middles):
        window, weights = window_at(unit, trust, i, radius, boundary, False)
        votes = sorted(
            (np.linalg.norm(between(middle, other)), weight)
            for other, weight in zip(window, weights, strict=True)
        )
        reached, typical = 0.0, 0.0
        for distance, vote in votes:
            reached, typical = reached + vote, distance
            if reached >= 0.5 * sum(weights):
                break
        if np.linalg.norm(between(middle, unit[i])) > n_sigmas * typical / 1.5381722544550522:
            result[i] = middle
    return fill(result, trust, causal=False)


def one_euro(q, weight, min_cutoff, beta, d_cutoff, frame_rate):
    """Casiez et al., algorithm 1, with alpha written by the time constant as in their eq. 6."""

    def alpha(cutoff, period):
        return 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff) / period)

    unit, trust = prepare(q, weight, causal=True)
    if not any(trust):
        return unit
    result, speed, period = [unit[0]], np.zeros(3), 1.0 / frame_rate
    for i in range(1, len(unit)):
        if trust[i] == 0.0:
            result.append(result[-1])
            period += 1.0 / frame_rate
            continue
        v = between(result[-1], unit[i])
        speed = speed + alpha(d_cutoff, period * trust[i]) * (v / period - speed)
        cutoff = min_cutoff + beta * np.linalg.norm(speed)
        result.append(turned(result[-1], alpha(cutoff, period * trust[i]) * v))
        period = 1.0 / frame_rate
    return np.array(result)


def kalman(q, weight, process_noise, measurement_noise, order):
    """Matrices of 3 ``order`` rows, inverted as they are; a wide start instead of none."""
    unit, trust = prepare(q, weight, causal=False)
    if not any(trust):
        return unit
    step = np.eye(order)
    process = np.empty((order, order))
    for a in range(order):
        for b in range(order):
            power = 2 * order - 1 - a - b
            process[a, b] = 1.0 / (power * math.factorial(order - 1 - a))
            process[a, b] /= math.factorial(order - 1 - b)
            if b > a:
                step[a, b] = 1.0 / math.factorial(b - a)
    big, block = np.eye(3), 3 * order
    step, process = np.kron(step, big), process_noise**2 * np.kron(process, big)
    seen = np.eye(3, block)
    wide = 1e7 * (measurement_noise**2 + process_noise**2)
    rotation, rates, cov = unit[0], np.zeros(block - 3), wide * np.eye(block)
    ahead, known = [], []
    for i, measured in enumerate(unit):
        if any(trust[:i] > 0):
            moved = step @ np.concatenate([np.zeros(3), rates])
            rotation, rates, cov = (
                turned(rotation, moved[:3]),
                moved[3:],
                step @ cov @ step.T + process,
            )
        ahead.append((rotation, rates, cov))
        if trust[i] > 0:
            noise = measurement_noise**2 / trust[i] * np.eye(3)
            gain = cov @ seen.T @ np.linalg.inv(seen @ cov @ seen.T + noise)
            error = gain @ between(rotation, measured)
            rotation, rates = turned(rotation, error[:3]), rates + error[3:]
            rest = np.eye(block) - gain @ seen
            cov = rest @ cov @ rest.T + gain @ noise @ gain.T
        known.append((rotation, rates, cov))
    result = [known[-1]]
    for (here, slope, cov), (there, expected, wide) in zip(
        known[-2::-1], ahead[:0:-1], strict=True
    ):
        error = np.concatenate([between(there, result[-1][0]), result[-1][1] - expected])
        error = cov @ step.T @ np.linalg.inv(wide) @ error
        result.append((turned(here, error[:3]), slope + error[3:]))
    rotations = np.array([each[0] for each in result[::-1]])
    present = np.flatnonzero(trust)
    rotations[: present[0]], rotations[present[-1] :] = (
        rotations[present[0]],
        rotations[present[-1]],
    )
    return rotations


def mean_rotation(q, weight):
    mean = q[np.argmax(weight)]
    for _ in range(60):
        mean = turned(
            mean,
            sum(w * between(mean, each) for w, each in zip(weight, q, strict=True)) / weight.sum(),
        )
    return mean


def poses(q, weight):
    """Points ``(T, 3 J)`` at the mean rotations, and these."""
    joints = range(q.shape[1])
    pairs = [prepare(q[:, j], weight[:, j], causal=False) for j in joints]
    means = [mean_rotation(*pair) for pair in pairs]
    points = [[between(means[j], pairs[j][0][t]) for j in joints] for t in range(len(q))]
    return np.array(points).reshape(len(q), -1), means, np.stack([p[1] for p in pairs], 1)


def rotations_of(points, means):
    return np.array(
        [
            [turned(mean, v) for mean, v in zip(means, pose.reshape(-1, 3), strict=True)]
            for pose in points
        ]
    )


def principal_components(q, weight, components):
    points, means, trust = poses(q, weight)
    trust = trust.repeat(3, 1)
    offset = points - (trust * points).sum(0) / trust.sum(0)
    _, sizes, rows = np.linalg.svd(np.sqrt(trust) * offset, full_matrices=False)
    kept = components
    if isinstance(components, float):
        kept = 1 + np.sum(np.cumsum(sizes**2) < components * np.sum(sizes**2))
    rows = rows[:kept]
    return rotations_of(points - offset + offset @ rows.T @ rows, means)


def kernel_pca(q, components, sigma, iterations, anchors=None):
    """Mika et al. with the centred Gram matrix of these poses, or all; none of them is missing."""
    points, means, _ = poses(q, np.ones(q.shape[:2]))
    seen = points if anchors is None else points[anchors]
    frames, axes = seen.shape

    def kernel(a, b):
        return math.exp(-((a - b) @ (a - b)) / (2.0 * axes * sigma**2))

    gram = np.array([[kernel(a, b) for b in seen] for a in seen])
    centring = np.eye(frames) - 1.0 / frames
    values, vectors = np.linalg.eigh(centring @ gram @ centring)
    values, vectors = values[::-1][:components], vectors[:, ::-1][:, :components]
    result = []
    for pose in points:
        own = np.array([kernel(pose, each) for each in seen])
        features = (vectors / np.sqrt(values)).T @ (centring @ (own - gram.mean(1)))
        gamma = centring @ (vectors / np.sqrt(values)) @ features + 1.0 / frames
        x = pose
        for _ in range(iterations):
            pull = gamma * np.array([kernel(x, each) for each in seen])
            if pull.sum() > 0.05 * np.abs(pull).sum():
                x = pull @ seen / pull.sum()
        result.append(x)
    return rotations_of(np.array(result), means)
