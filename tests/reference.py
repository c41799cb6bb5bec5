"""Oracle: the filters in plain NumPy loops, one joint and one frame at a time.

Nothing here comes from the package. Rotations are quaternions ``x, y, z, w``; a sequence is
``(T, 4)`` and its weights ``(T,)``. Windows are walked frame by frame, and the step is Courty's
eq. 2 taken literally: increments times ``b_r``.
"""

import math

import numpy as np

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def multiply(a, b):
    x1, y1, z1, w1 = a
    x2, y2, z2, w2 = b
    return np.array(
        [
            w1 * x2 + w2 * x1 + (y1 * z2 - z1 * y2),
            w1 * y2 + w2 * y1 + (z1 * x2 - x1 * z2),
            w1 * z2 + w2 * z1 + (x1 * y2 - y1 * x2),
            w1 * w2 - (x1 * x2 + y1 * y2 + z1 * z2),
        ]
    )


def conjugate(a):
    return np.array([-a[0], -a[1], -a[2], a[3]])


def rotation_vector(a):
    """Angle times axis of the shorter of the two turns."""
    sine, cosine = math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2), a[3]
    if sine == 0.0:
        return np.zeros(3)
    if cosine < 0.0:
        sine_sign, cosine = -1.0, -cosine
    else:
        sine_sign = 1.0
    return sine_sign * 2.0 * math.atan2(sine, cosine) / sine * a[:3]


def quaternion(v):
    angle = math.sqrt(v @ v)
    if angle == 0.0:
        return IDENTITY.copy()
    return np.append(math.sin(angle / 2) * v / angle, math.cos(angle / 2))


def between(a, b):
    return rotation_vector(multiply(conjugate(a), b))


def prepare(q, weight, causal):
    """Unit quaternions without gaps, and weights that are 0 where a frame is missing."""
    frames = len(q)
    unit, trust = np.tile(IDENTITY, (frames, 1)), np.zeros(frames)
    for t in range(frames):
        usable = all(math.isfinite(value) for value in q[t]) and any(q[t])
        if usable:
            unit[t] = q[t] / math.sqrt(q[t] @ q[t])
            trusted = math.isfinite(weight[t]) and weight[t] > 0
            trust[t] = weight[t] if trusted else 0.0
    return fill(unit, trust, causal), trust


def fill(unit, trust, causal):
    known = [t for t in range(len(unit)) if trust[t] > 0]
    filled = unit.copy()
    for t in range(len(unit)):
        if t in known or not known:
            continue
        past = [k for k in known if k < t]
        future = [k for k in known if k > t]
        if past and future and not causal:
            share = (t - past[-1]) / (future[0] - past[-1])
            turn = between(unit[past[-1]], unit[future[0]])
            filled[t] = multiply(unit[past[-1]], quaternion(share * turn))
        else:
            filled[t] = unit[past[-1]] if past else unit[future[0]]
    return filled


def frame_at(q, trust, t, boundary):
    """Rotation and weight at any place, inside the sequence or outside."""
    frames = len(q)
    if 0 <= t < frames:
        return q[t], trust[t]
    edge = 0 if t < 0 else frames - 1
    if boundary == "truncate":
        return q[edge], 0.0
    if boundary == "replicate":
        return q[edge], trust[edge]
    if boundary == "circular":
        return q[t % frames], trust[t % frames]
    if boundary == "reflect":
        place, step = 0, 1  # walk to and fro
        for _ in range(abs(t) if t < 0 else t):
            if frames > 1:
                step = -step if not 0 <= place + step < frames else step
                place += step
        return q[place], trust[place]
    assert boundary == "extrapolate"
    if frames == 1:
        return q[0], trust[0]
    turn = between(q[1], q[0]) if t < 0 else between(q[-2], q[-1])
    place, steps = q[edge], -t if t < 0 else t - edge
    for _ in range(steps):
        place = multiply(place, quaternion(turn))
    return place, trust[edge]


def move(window, mask, printed_sign=False):
    """Eq. 2 and 3 for a window of ``2k + 1`` rotations and a mask that sums to 1 (or to 0)."""
    k = len(window) // 2
    step = np.zeros(3)
    for r in range(-k, k):
        if r >= 0:
            b = sum(mask[j + k] for j in range(r + 1, k + 1))
        else:
            b = sum(mask[j + k] for j in range(-k, r + 1))
            b = b if printed_sign else -b
        step = step + b * between(window[r + k], window[r + k + 1])
    return step


def window_at(q, trust, i, radius, boundary, causal):
    if causal and boundary != "replicate":
        boundary = "truncate"
    pairs = [frame_at(q, trust, i + r, boundary) for r in range(-radius, radius + 1)]
    weights = [pair[1] if not (causal and r > radius) else 0.0 for r, pair in enumerate(pairs)]
    return [pair[0] for pair in pairs], weights


def share(values):
    total = sum(values)
    return [value / total for value in values] if total > 0 else None


def linear_filter(q, weight, mask, boundary="reflect", causal=False):
    """Positive and negative entries of the mask are normalised by the weights apart."""
    unit, trust = prepare(q, weight, causal)
    radius = len(mask) // 2
    mask = [0.0 if causal and j > radius else m for j, m in enumerate(mask)]
    mask = [m / sum(mask) for m in mask]
    result = []
    for i in range(len(unit)):
        window, weights = window_at(unit, trust, i, radius, boundary, causal)
        up = share([max(m, 0.0) * w for m, w in zip(mask, weights, strict=True)])
        down = share([max(-m, 0.0) * w for m, w in zip(mask, weights, strict=True)])
        up, down = up or down, down or up
        step = np.zeros(3)
        if up:
            step = sum(max(m, 0.0) for m in mask) * move(window, up)
            step = step - sum(max(-m, 0.0) for m in mask) * move(window, down)
        result.append(multiply(unit[i], quaternion(step)))
    return np.array(result)


def gaussian_filter(q, weight, sigma_t, radius, boundary="reflect", causal=False):
    mask = [math.exp(-(j**2) / (2 * sigma_t**2)) for j in range(-radius, radius + 1)]
    return linear_filter(q, weight, mask, boundary, causal)


def bilateral_filter(
    q,
    weight,
    sigma_t,
    sigma_g,
    radius,
    kernel="gaussian",
    iterations=1,
    boundary="reflect",
    causal=False,
    printed_sign=False,
):
    unit, trust = prepare(q, weight, causal)
    for iteration in range(iterations):
        if iteration:
            unit = fill(unit, trust, causal)
        moved = []
        for i in range(len(unit)):
            window, weights = window_at(unit, trust, i, radius, boundary, causal)
            mask = []
            for r, other in enumerate(window, -radius):
                v = between(unit[i], other)
                angle = math.sqrt(v @ v)
                if kernel == "gaussian":
                    m = math.exp(-(r**2) / (2 * sigma_t**2)) * math.exp(
                        -(angle**2) / (2 * sigma_g**2)
                    )
                else:  # printed: the quaternion's logarithm is half a rotation vector
                    m = math.exp(-abs(r) / (2 * sigma_t**2)) * math.exp(
                        -(angle / 2) / (2 * sigma_g**2)
                    )
                mask.append(m * weights[r + radius])
            mask = share(mask)
            step = move(window, mask, printed_sign) if mask else np.zeros(3)
            moved.append(multiply(unit[i], quaternion(step)))
        unit = np.array(moved)
    return unit


def every_joint(function, q, weight, *, per_joint=None, **options):
    """Run a filter of one sequence on ``(T, J, 4)``; ``per_joint`` has a value for each joint."""
    result = np.empty_like(q)
    for joint in range(q.shape[1]):
        own = {name: values[joint] for name, values in (per_joint or {}).items()}
        result[:, joint] = function(q[:, joint], weight[:, joint], **options, **own)
    return result
