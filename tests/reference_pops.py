"""Oracle: displaced stretches of one joint found and moved back in plain loops.

Nothing here comes from the package.
"""

import math

import numpy as np
from reference import conjugate, multiply, quaternion, rotation_vector

LONGEST, LONGEST_AT_END = 24, 15


def step_to(q, t):
    return multiply(conjugate(q[t - 1]), q[t])


def size(rotation):
    return float(np.linalg.norm(rotation_vector(rotation)))


def beside(q, t):
    """Steps before and after the one that ends in ``t``; at the ends one stands for both."""
    return [step_to(q, t - 1 if t > 1 else t + 1), step_to(q, t + 1 if t < len(q) - 1 else t - 1)]


def excess(q, t):
    before, after = (quaternion(-rotation_vector(step) / 2) for step in beside(q, t))
    return multiply(multiply(before, step_to(q, t)), after)


def usual(angles, counted, t):
    near = [abs(s - t) for s in range(len(angles))]
    roots = [math.sqrt(angles[s]) for s, far in enumerate(near) if 1 < far <= 8 and counted[s]]
    return (sum(roots) / max(len(roots), 1)) ** 2


def jumps(q, present, noise):
    """``{t: (excess, usual, ending)}`` of the steps that are jumps."""
    every = range(1, len(q))
    angles = [0.0] + [size(excess(q, t)) for t in every]
    known = [t > 0 and present[t] and present[t - 1] for t in range(len(q))]
    gesture = [0.0] + [2.0 * sum(size(step) for step in beside(q, t)) for t in every]
    likely = [
        known[t] and angles[t] > max(3.0 * usual(angles, known, t), gesture[t], 0.3)
        for t in range(len(q))
    ]
    calm = [known[t] and not any(likely[max(t - 1, 0) : t + 2]) for t in range(len(q))]
    found = {}
    for t in every:
        around = usual(angles, calm, t)
        if likely[t] and angles[t] > max(12.0 * around, 3.0 * math.sqrt(15.0) * noise):
            found[t] = (excess(q, t), around, angles[t] > max(24.0 * around, 0.5))
    return found


def length_until_back(found, t):
    """Frames until another jump has led back, and what is left then; 0 where none does."""
    first, around, _ = found[t]
    way = first
    for lag in range(1, LONGEST + 1):
        if t + lag in found:
            way = multiply(way, found[t + lag][0])
            if lag > 1 and size(way) < max(0.3 * size(first), 2.0 * around):
                return lag, rotation_vector(way)
    return 0, np.zeros(3)


def moved_back(q, present, noise=0.0):
    found = jumps(q, present, noise)
    result, end, free = q.copy(), -1, []
    for t in sorted(found):
        length, rest = length_until_back(found, t)
        if t <= end:
            continue
        if length == 0 and found[t][2]:
            free.append(t)
        if length > 0:
            end = t + length
            way = np.array([0.0, 0.0, 0.0, 1.0])
            for lag in range(length):
                way = multiply(way, found[t + lag][0]) if t + lag in found else way
                here = multiply(quaternion(-(lag + 0.5) / length * rest), way)
                result[t + lag] = multiply(q[t + lag], conjugate(here))
    return at_the_ends(q, result, found, free)


def at_the_ends(q, result, found, free):
    """The last stretch and the first, which reach beyond the sequence."""
    frames = len(q)
    last = [t for t in free if frames - t <= LONGEST_AT_END and 3 * (frames - t) < frames]
    first = [t for t in free if t <= LONGEST_AT_END and 3 * t < frames]
    way = np.array([0.0, 0.0, 0.0, 1.0])
    for t in range(last[0], frames) if last else ():
        way = multiply(way, found[t][0]) if t in found else way
        result[t] = multiply(q[t], conjugate(way))
    way = np.array([0.0, 0.0, 0.0, 1.0])
    for t in range(first[-1], 0, -1) if first else ():
        way = multiply(way, conjugate(found[t][0])) if t in found else way
        result[t - 1] = multiply(q[t - 1], conjugate(way))
    return result
