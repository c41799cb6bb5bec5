"""Oracle: which correlation noise has, one window, one joint, one axis at a time, in NumPy.

Nothing here comes from the package.
"""

import functools
import itertools
import math

import numpy as np
from reference import between
from reference_spectra import correlated_power, summed_steps, window_starts


@functools.cache
def bands(size):
    """Coefficients that are taken together: the lowest ten alone, others a sixth of an octave."""
    found = [[k] for k in range(1, min(size, 11))]
    edges = [11 * 2 ** (i / 6) for i in range(17)]
    for low, high in itertools.pairwise(edges):
        found.append([k for k in range(11, size) if low <= k < high])
    return [band for band in found if band]


@functools.cache
def priors(size):
    """Power laws of half cycles in 64 frames ``(M, W)``."""
    frequency = np.array([max(64 * k / size, 0.5) for k in range(size)])
    return np.array([math.e**a * frequency**-p for p in (2, 3.5, 5) for a in range(-4, 33)])


def likelihood(power, noise, size):
    """Of squared coefficients ``(W,)`` in noise of this colour and size; the first is not used."""
    powers = priors(len(power))[:, 1:] + np.array(noise)[1:]
    smooth = np.zeros(len(power))
    for band in bands(len(power)):
        smooth[band] = np.mean(power[band])
    misfit = np.log(powers).sum(1) + (smooth[1:] / size**2 / powers).sum(1)
    most = (-misfit / 2).max()
    total = np.exp(-misfit / 2 - most).sum()
    return most + math.log(total) - (len(power) - 1) * math.log(size)


def evidence(q, motion, present, sigma, rhos, stretch=None):
    """Of every correlation, for ``q (T, J, 4)`` and sizes ``(R, J)``.

    ``stretch`` are axes, one a column, ``(J, 3, 3)``, and how much larger the noise is about each.
    """
    frames, joints = present.shape
    size, starts = window_starts(frames, 64, hops=1)
    if frames > size:
        half = min(len(starts) // 2, 32)
        ahead = [i * (frames - size) // (2 * half - 1) for i in range(half)]
        starts = ahead + [frames - size - start for start in ahead]
    else:
        starts = [0, 0]  # windows come in pairs
    axes, factor = stretch or (np.tile(np.eye(3), (joints, 1, 1)), np.ones((joints, 3)))
    basis = [[math.cos(math.pi * k * (n + 0.5) / size) for n in range(size)] for k in range(size)]
    basis = np.array(basis) / np.linalg.norm(basis, axis=1, keepdims=True)
    colours = [correlated_power(size, rho) for rho in rhos]
    total = np.zeros(len(rhos))
    for start, joint in itertools.product(starts, range(joints)):
        part = slice(start, start + size)
        share = np.mean(present[part, joint])
        if share <= 0.5 or not all(sigma[:, joint] > 0):
            continue
        steps = [between(m, a) for m, a in zip(motion[part, joint], q[part, joint], strict=True)]
        x = summed_steps(motion[:, joint])[part] + present[part, joint, None] * np.array(steps)
        x = x @ axes[joint] / factor[joint] @ axes[joint].T / sigma[0, joint]
        powers = (basis @ (x - x.mean(0))) ** 2 / share
        for r, noise in enumerate(colours):
            relative = sigma[r, joint] / sigma[0, joint]
            total[r] += sum(likelihood(power, noise, relative) for power in powers.T)
    return total
