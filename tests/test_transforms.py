"""Compilers and function transforms, part C of the contract."""

import pytest
import torch
from motions import IDENTITY, assert_same_rotation, smooth_motion
from torch import nn

from torchquat import (
    AutoDenoiser,
    BilateralFilter,
    GaussianFilter,
    LiftingDenoiser,
    LinearFilter,
    LocalSpectrumFilter,
    LowRankFilter,
    NonLocalPoseMeans,
    OutlierRepair,
    so3,
)

FILTERS = {
    "gaussian": GaussianFilter(0.6),
    "linear": LinearFilter([-0.1, 1.2, -0.1], boundary="extrapolate"),
    "bilateral": BilateralFilter(0.6, 0.5, iterations=2),
    "bilateral-exponential-causal": BilateralFilter(0.6, 0.5, kernel="exponential", causal=True),
    "auto": AutoDenoiser(),
    "local-spectrum": LocalSpectrumFilter(),
    "local-spectrum-short": LocalSpectrumFilter(4, sigma=0.2),
    "low-rank": LowRankFilter(),
    "low-rank-short": LowRankFilter(3, sigma=0.2),
    "nonlocal": NonLocalPoseMeans(0.2, patch_radius=1, search_radius=2),
    "repair": OutlierRepair(),
    "lifting": LiftingDenoiser("squad", levels=1),
    "lifting-sure": LiftingDenoiser("haar", levels=1, rule="sure"),
    "lifting-bayes": LiftingDenoiser("haar", levels=1, rule="bayes", cycle_spins=2),
}


@pytest.fixture(params=FILTERS)
def run(request):
    torch.compiler.reset()
    return FILTERS[request.param]


def gradient(run, q):
    q = q.clone().requires_grad_()
    run(q).cumsum(-1).sum().backward()
    return q.grad


def with_gaps(rng, dtype):
    """NaN frames and half turns with either sign of zero."""
    q = smooth_motion(frames=10, rng=rng, dtype=dtype)
    q[3, 1] = torch.nan
    q[5, 0] = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=dtype)
    q[6, 0] = torch.tensor([1.0, 0.0, 0.0, -0.0], dtype=dtype)
    return q


def test_C1_C2_compiles_in_one_graph(run, rng):
    """The graph is what can break; code generation is tried in the slow test below."""
    compiled = torch.compile(run, fullgraph=True, backend="eager")
    for q in (smooth_motion(frames=10, rng=rng), with_gaps(rng, torch.float64)):
        q.requires_grad_()
        once = compiled(q)
        assert_same_rotation(once, run(q))
        (slope,) = torch.autograd.grad(once.cumsum(-1).sum(), q)
        assert torch.allclose(slope, gradient(run, q.detach()), atol=1e-10)


@pytest.mark.slow
def test_C1_C2_generated_code_agrees(run, rng):
    compiled = torch.compile(run, fullgraph=True)
    for q in (smooth_motion(rng=rng, dtype=torch.float32), with_gaps(rng, torch.float32)):
        assert_same_rotation(compiled(q), run(q), 5e-6)
        assert torch.allclose(gradient(compiled, q), gradient(run, q), atol=1e-5)


def test_C3_lengths_in_turn_do_not_compile_again(run, rng):
    graphs = []

    def counting(graph: nn.Module, inputs: list[torch.Tensor]):
        graphs.append(graph)
        return graph

    compiled = torch.compile(run, fullgraph=True, backend=counting)
    for frames in (5, 6, 7, 11, 50, 200):
        q = smooth_motion(frames=frames, rng=rng)
        assert_same_rotation(compiled(q), run(q))
        if frames == 6:
            first_two = len(graphs)
    assert len(graphs) <= first_two + 2


def test_C4_vmap_and_jacrev(run, rng):
    q = smooth_motion(2, frames=6, joints=1, rng=rng)
    assert_same_rotation(torch.func.vmap(run)(q), run(q))
    weight = torch.rand(2, 6, 1, generator=rng, dtype=q.dtype)
    assert_same_rotation(torch.func.vmap(run)(q, weight), run(q, weight))
    alone = torch.stack([torch.autograd.functional.jacobian(run, item) for item in q])
    assert torch.allclose(torch.func.vmap(torch.func.jacrev(run))(q), alone, atol=1e-12)


def test_C5_export_with_a_dynamic_length(run, rng):
    """Known limit: an exported lifting scheme of L levels takes 8 * 2^L frames and more."""
    shortest = 8 * 2**run.levels if isinstance(run, LiftingDenoiser) else 2
    q = smooth_motion(frames=shortest + 5, rng=rng)
    length = torch.export.Dim("frames", min=shortest, max=10000)
    program = torch.export.export(run, (q,), dynamic_shapes=({0: length},)).module()
    for frames in (shortest, shortest + 5, 4096):
        q = smooth_motion(frames=1, rng=rng).expand(frames, 3, 4).clone()
        q[frames // 2 :] = so3.compose(q[:1], so3.exp(torch.full((3,), 0.5, dtype=q.dtype)))
        assert_same_rotation(program(q), run(q))


@pytest.mark.filterwarnings("ignore:Anomaly Detection has been enabled")
def test_C6_anomaly_mode(run, rng):
    with torch.autograd.detect_anomaly(check_nan=True):
        for q in (
            with_gaps(rng, torch.float64),
            IDENTITY.expand(6, 3, 4),
            -IDENTITY.expand(6, 3, 4),
            torch.zeros(6, 3, 4),
        ):
            assert gradient(run, q).isfinite().all()
