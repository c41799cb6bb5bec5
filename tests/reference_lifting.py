"""Oracle of the lifting scheme and its denoiser in plain loops; a sequence is ``(T, 4)``."""

import math
import statistics

import numpy as np
from reference import between, multiply, prepare, quaternion


def turn(a, b, share):
    return multiply(a, quaternion(share * between(a, b)))


def at(even, i):
    """An even frame, also beyond the ends, where the increment at the edge continues."""
    last = len(even) - 1
    if 0 <= i <= last or last < 1:
        return even[min(max(i, 0), last)]
    if i < 0:
        return turn(even[1], even[0], 1.0 - i)
    return turn(even[last - 1], even[last], 1.0 + i - last)


def control(even, i):
    own = at(even, i)
    bend = between(own, at(even, i + 1)) + between(own, at(even, i - 1))
    return multiply(own, quaternion(-bend / 4.0))


def predict(wavelet, even, i):
    a, b = at(even, i), at(even, i + 1)
    if wavelet == "haar":
        return a
    if wavelet == "linear":
        return turn(a, b, 0.5)
    s, t = control(even, i), control(even, i + 1)
    if wavelet == "squad":
        return turn(turn(a, b, 0.5), turn(s, t, 0.5), 2 * 0.5 * (1 - 0.5))
    first, second, third = turn(a, s, 0.5), turn(s, t, 0.5), turn(t, b, 0.5)
    return turn(turn(first, second, 0.5), turn(second, third, 0.5), 0.5)


def step(wavelet, details, i):
    own = details[i] if i < len(details) else np.zeros(3)
    if wavelet == "haar":
        return own / 2.0
    return ((details[i - 1] if i > 0 else np.zeros(3)) + own) / 4.0


def split(q, wavelet):
    even, odd = q[0::2], q[1::2]
    details = [between(predict(wavelet, even, i), odd[i]) for i in range(len(odd))]
    coarse = [multiply(e, quaternion(step(wavelet, details, i))) for i, e in enumerate(even)]
    return coarse, details


def join(coarse, details, wavelet):
    even = [multiply(c, quaternion(-step(wavelet, details, i))) for i, c in enumerate(coarse)]
    q = []
    for i in range(len(even)):
        q.append(even[i])
        if i < len(details):
            q.append(multiply(predict(wavelet, even, i), quaternion(details[i])))
    return q


def transform(q, wavelet, levels):
    """Approximation and details, coarsest first."""
    coarse, details = list(q), []
    for _ in range(levels):
        coarse, detail = split(coarse, wavelet)
        details.insert(0, detail)
    return coarse, details


def inverse(coarse, details, wavelet):
    for detail in details:
        coarse = join(coarse, detail, wavelet)
    return np.array(coarse)


def norm(v):
    return math.sqrt(v @ v)


def valid_details(present):
    """Which details of a level come from present frames alone."""
    even, odd = present[0::2], present[1::2]
    return [
        odd[i] and even[i] and (even[i + 1] if i + 1 < len(even) else even[i])
        for i in range(len(odd))
    ]


def noise_of(q, present):
    _, (details,) = transform(q, "linear", 1)
    between_two = (len(q) - 1) // 2  # the last odd frame may have nothing after it
    judged = list(zip(details, valid_details(present), strict=True))[:between_two]
    lengths = [norm(d) for d, ok in judged if ok]
    # median of the chi distribution of three degrees of freedom; noise of o - (e + e) / 2
    return statistics.median(lengths) / 1.5381722544 / math.sqrt(1.5) if lengths else 0.0


def gains(wavelet, levels):
    """Noise of the details of each level for unit noise, coarsest first, on numbers."""
    found = []
    weights = {"linear": (0, 1 / 2, 1 / 2, 0), "squad": (-1 / 16, 9 / 16, 9 / 16, -1 / 16)}
    weights |= {"haar": (0, 1, 0, 0), "bezier": (-3 / 32, 19 / 32, 19 / 32, -3 / 32)}
    coarse = np.eye(16 * 2**levels)  # rows: frames as combinations of the noise of all frames
    for _ in range(levels):
        even, odd = coarse[0::2], coarse[1::2]
        before, after, later = np.roll(even, 1, 0), np.roll(even, -1, 0), np.roll(even, -2, 0)
        parts = zip(weights[wavelet], (before, even, after, later), strict=True)
        detail = odd - sum(w * part for w, part in parts)
        move = detail / 2 if wavelet == "haar" else (detail + np.roll(detail, 1, 0)) / 4
        coarse = even + move
        found.insert(0, math.sqrt((detail[len(detail) // 2] ** 2).sum()))
    return found


def universal(sigma, count):
    logarithm = math.log(max(count, math.e))
    return sigma * math.sqrt(2 * logarithm + math.log(logarithm))


def stein_risk(t, lengths, sigma):
    risk = 0.0
    for r in lengths:
        if r <= t:
            risk += r**2 - 3 * sigma**2
        else:
            risk += t**2 + 3 * sigma**2 - 2 * sigma**2 * 2 * t / r
    return risk


def threshold(rule, lengths, sigma):
    largest = max(lengths, default=0.0)
    if rule == "universal":
        return universal(sigma, len(lengths))
    if rule == "sure":
        best = min([0.0, *lengths], key=lambda t: stein_risk(t, lengths, sigma))
        return min(best, universal(sigma, len(lengths)))
    signal = sum(r**2 for r in lengths) / (3 * max(len(lengths), 1)) - sigma**2
    return min(math.sqrt(3) * sigma**2 / math.sqrt(signal), largest) if signal > 0 else largest


def shrink(v, t, kind):
    r = norm(v)
    if r <= t:
        return v if t == 0 else 0.0 * v
    return {"soft": 1 - t / r, "hard": 1.0, "garrote": 1 - (t / r) ** 2}[kind] * v


def denoise(q, weight, *, wavelet, levels, rule, shrinkage, sigma=None):
    unit, trust = prepare(q, weight, False)
    present = [w > 0 for w in trust]
    if not any(present):  # nothing to go by: it stays as it is
        return np.array(unit)
    sigma = noise_of(unit, present) if sigma is None else sigma
    gain = gains(wavelet, levels)
    coarse, details = transform(unit, wavelet, levels)
    for level in range(levels - 1, -1, -1):
        valid = valid_details(present)
        present = present[0::2]
        if isinstance(rule, str) and rule != "finest":
            lengths = [norm(d) for d, ok in zip(details[level], valid, strict=True) if ok]
            t = threshold(rule, lengths, sigma * gain[level])
        else:
            t = math.inf if rule == "finest" else rule[level]
        details[level] = [shrink(d, t, shrinkage) for d in details[level]]
    return inverse(coarse, details, wavelet)
