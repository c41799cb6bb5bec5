"""Oracle of non-local pose means in plain loops: every patch gathered, every distance by itself."""

import math

import numpy as np
from reference import between, frame_at, multiply, prepare, quaternion, rotation_vector


def nonlocal_pose_means(
    q,
    weight,
    *,
    sigma,
    patch_radius,
    search_radius,
    groups,
    chart="local",
    boundary="replicate",
    causal=False,
):
    """``(T, J, 4)`` and ``(T, J)``; ``groups`` is a number for every joint."""
    frames, joints = q.shape[:2]
    columns = [prepare(q[:, j], weight[:, j], causal) for j in range(joints)]
    if causal and boundary != "replicate":
        boundary = "truncate"

    def at(j, t):
        return frame_at(*columns[j], t, boundary)

    def difference(a, b):
        if chart == "local":
            return between(a, b)
        return rotation_vector(b) - rotation_vector(a)

    def patch_distance(i, k, group):
        total, common = 0.0, 0.0
        for p in range(-patch_radius, 1 if causal else patch_radius + 1):
            for j in range(joints):
                if groups[j] == group:
                    (a, trust_a), (b, trust_b) = at(j, i + p), at(j, k + p)
                    v = difference(a, b)
                    total += trust_a * trust_b * (v @ v) / 3.0
                    common += trust_a * trust_b
        return total / common if common > 0 else None

    result = np.empty_like(q)
    for i in range(frames):
        for j in range(joints):
            own, own_trust = at(j, i)
            found = []
            for k in range(i - search_radius, i + (0 if causal else search_radius) + 1):
                other, trust = at(j, k)
                distance = patch_distance(i, k, groups[j])
                if k != i and distance is not None and trust > 0:
                    found.append((distance, trust, difference(own, other)))
            nearest = min((distance for distance, _, _ in found), default=0.0)
            total, step = own_trust, np.zeros(3)
            for distance, trust, v in found:  # relative to the centre's weight, the largest
                m = trust * math.exp((nearest - distance) / (2 * sigma**2))
                total, step = total + m, step + m * v
            step = step / total if total > 0 else step
            if chart == "local":
                result[i, j] = multiply(own, quaternion(step))
            else:
                result[i, j] = quaternion(rotation_vector(own) + step)
    return result
