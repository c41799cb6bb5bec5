"""Filters that can be fed frame by frame, and what is fed to them."""

import filters_under_test as filters
import torch
from motions import smooth_motion

from torchquat import BilateralFilter, GaussianFilter, NonLocalPoseMeans, Stream, so3

# A new filter joins here or in REFUSED by one line: what it is in filters_under_test, its latency.
LATENCY = {
    "gaussian": 5,
    "gaussian-truncate": 5,
    "gaussian-causal": 0,
    "linear": 2,
    "linear-causal": 0,
    "linear-asymmetric": 2,
    "bilateral": 10,
    "bilateral-exponential": 5,
    "bilateral-per-joint": 6,
    "bilateral-causal": 0,
    "nonlocal-joint": 5,
    "nonlocal-pose": 5,
    "nonlocal-causal": 0,
    "savitzky-golay-reflect": 2,
    "moving-mean": 2,
    "butterworth": 21,
    "butterworth-extrapolate": 32,
    "median": 2,
    "median-truncate": 1,
    "hampel": 2,
    "one-euro": 0,
}
ONLINE = {name: (filters.ALL[name], latency) for name, latency in LATENCY.items()} | {
    "nonlocal-global": (NonLocalPoseMeans(0.3, patch_radius=1, search_radius=2, chart="global"), 3),
    "nonlocal-groups": (NonLocalPoseMeans(0.3, patch_radius=2, groups=[0, 1, 0], causal=True), 0),
    "bilateral-replicate": (BilateralFilter(1.0, 0.5, boundary="replicate", causal=True), 0),
    "bilateral-thrice": (BilateralFilter(0.6, 0.5, iterations=3, boundary="truncate"), 6),
    "bilateral-never": (BilateralFilter(0.6, 0.5, iterations=0), 0),
    "gaussian-alone": (GaussianFilter(1.0, radius=0), 0),
}


def noisy(*batch, rng, frames=40, dtype=torch.float64):
    """Motion with noise, signs and norms at random."""
    q = smooth_motion(*batch, frames=frames, rng=rng, dtype=dtype)
    q = so3.turn(q, 0.15 * torch.randn(*q.shape[:-1], 3, generator=rng, dtype=dtype))
    return q * (2.0 * torch.randn(*q.shape[:-1], 1, generator=rng, dtype=dtype).sign())


def with_gaps(q, rng):
    """Some samples not a number, others of weight 0; the first and the last frame are whole."""
    weight = 0.2 + torch.rand(q.shape[:-1], generator=rng, dtype=q.dtype)
    lost = torch.rand(q.shape[:-1], generator=rng) < 0.1
    weight[torch.rand(q.shape[:-1], generator=rng) < 0.1] = 0.0
    weight[..., [0, -1], :], lost[..., [0, -1], :] = 1.0, False
    return torch.where(lost[..., None], torch.nan, q), weight


def streamed(run, q, weight=None):
    """All frames ``(..., T, J, 4)``, pushed one by one."""
    stream = Stream(run)
    out = []
    for t in range(q.shape[-3]):
        out.append(stream.push(q[..., t, :, :], None if weight is None else weight[..., t, :]))
    rest = stream.flush()
    held_back = min(stream.latency, q.shape[-3])
    assert [x is None for x in out] == [t < held_back for t in range(q.shape[-3])]
    out = torch.stack([x for x in out if x is not None] or [q[..., 0, :, :]], -3)
    return torch.cat([out[..., : q.shape[-3] - held_back, :, :], rest], -3)
