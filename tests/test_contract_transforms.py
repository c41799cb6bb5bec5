"""Compilers and function transforms, part C of the contract."""

import pytest
import torch
from motions import IDENTITY, assert_same_rotation, smooth_motion
from torch import nn

from torchquat import (
    AutoDenoiser,
    BilateralFilter,
    ButterworthFilter,
    GaussianFilter,
    HampelFilter,
    KalmanSmoother,
    KernelPCAFilter,
    LiftingDenoiser,
    LinearFilter,
    LocalSpectrumFilter,
    LowRankFilter,
    MedianFilter,
    MovingMeanFilter,
    NonLocalPoseMeans,
    OneEuroFilter,
    OutlierRepair,
    PrincipalComponentFilter,
    SavitzkyGolayFilter,
    so3,
)

QUICK = {
    "bilateral": BilateralFilter(0.6, 0.5),
    "nonlocal": NonLocalPoseMeans(0.2, patch_radius=1, search_radius=2),
    "lifting": LiftingDenoiser("haar", levels=1, rule=0.1),
}
"""One filter a paper; compiling the others takes minutes, and is left to ``-m slow``."""
OTHERS = {
    "gaussian": GaussianFilter(0.6),
    "median": MedianFilter(1, iterations=1),
    "principal-components": PrincipalComponentFilter(2),
    "linear": LinearFilter([-0.1, 1.2, -0.1], boundary="extrapolate"),
    "moving-mean": MovingMeanFilter(),
    "savitzky-golay": SavitzkyGolayFilter(2, 2),
    "butterworth": ButterworthFilter(0.25),
    "bilateral-twice": BilateralFilter(0.6, 0.5, iterations=2),
    "bilateral-exponential-causal": BilateralFilter(0.6, 0.5, kernel="exponential", causal=True),
    "lifting-squad": LiftingDenoiser("squad", levels=1),
    "lifting-sure": LiftingDenoiser("haar", levels=1, rule="sure"),
    "lifting-bayes": LiftingDenoiser("haar", levels=1, rule="bayes", cycle_spins=2),
    "hampel": HampelFilter(1, 1.0, iterations=2),
    "kernel-pca": KernelPCAFilter(0.8, sigma=0.3, landmarks=8, iterations=2),
    "local-spectrum": LocalSpectrumFilter(),
    "local-spectrum-short": LocalSpectrumFilter(4, sigma=0.2),
    "low-rank": LowRankFilter(),
    "low-rank-short": LowRankFilter(3, sigma=0.2),
    "auto": AutoDenoiser(),
    "repair": OutlierRepair(),
}
RECURSIVE = {
    "one-euro": OneEuroFilter(0.05, 0.2, d_cutoff=0.1),
    "kalman": KalmanSmoother(0.1, 0.3),
}
"""Python steps through their frames, so a compiler has every length as a program of its own."""

FIXED = torch._dynamo.exc.UserError
ONE_LENGTH = (
    "local-spectrum-short",
    "local-spectrum",
    "low-rank",
    "low-rank-short",
    "auto",
    "repair",
)
"""How many windows there are, or which neighbours, is fixed when these are exported."""

WINDOWED = QUICK | OTHERS
FILTERS = WINDOWED | RECURSIVE


@pytest.fixture(params=FILTERS)
def run(request):
    return FILTERS[request.param]


@pytest.fixture(params=[*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)])
def windowed(request):
    torch.compiler.reset()
    return FILTERS[request.param]


@pytest.fixture(params=RECURSIVE)
def recursive(request):
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


def check_compiles(run, rng):
    compiled = torch.compile(run, fullgraph=True, backend="eager")
    for q in (smooth_motion(frames=10, rng=rng), with_gaps(rng, torch.float64)):
        q.requires_grad_()
        once = compiled(q)
        assert_same_rotation(once, run(q))
        (slope,) = torch.autograd.grad(once.cumsum(-1).sum(), q)
        assert torch.allclose(slope, gradient(run, q.detach()), atol=1e-10)


def test_C1_C2_compiles_in_one_graph(windowed, rng):
    """The graph is what can break; code generation is tried in the slow test below."""
    check_compiles(windowed, rng)


@pytest.mark.slow
def test_C1_C2_recursive_filters_compile_in_one_graph(recursive, rng):
    check_compiles(recursive, rng)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")  # inductor's own
def test_C1_C2_generated_code_agrees(windowed, rng):
    compiled = torch.compile(windowed, fullgraph=True)
    for q in (smooth_motion(rng=rng, dtype=torch.float32), with_gaps(rng, torch.float32)):
        assert_same_rotation(compiled(q), windowed(q), 5e-6)
        assert torch.allclose(gradient(compiled, q), gradient(windowed, q), atol=1e-5)


def compilations(run, lengths, rng):
    """How many graphs were made after the first two lengths."""
    graphs = []

    def counting(graph: nn.Module, inputs: list[torch.Tensor]):
        graphs.append(graph)
        return graph

    compiled = torch.compile(run, fullgraph=True, backend=counting)
    first_two = 0
    for place, frames in enumerate(lengths):
        q = smooth_motion(frames=frames, rng=rng)
        assert_same_rotation(compiled(q), run(q))
        first_two = len(graphs) if place < 2 else first_two
    return len(graphs) - first_two


@pytest.mark.parametrize(
    "name", ["bilateral", pytest.param("local-spectrum-short", marks=pytest.mark.slow)]
)
def test_C3_lengths_in_turn_do_not_compile_again(name, rng):
    torch.compiler.reset()
    assert compilations(FILTERS[name], (5, 6, 7, 50), rng) <= 2


@pytest.mark.slow
def test_C3_many_lengths_in_turn_do_not_compile_again(windowed, rng):
    assert compilations(windowed, (5, 6, 7, 11, 50, 200), rng) <= 2


@pytest.mark.slow
@pytest.mark.xfail(reason="frames are unrolled", raises=AssertionError, strict=True)
def test_C3_known_limit_recursive_filters_compile_for_every_length(recursive, rng):
    assert compilations(recursive, (2, 3, 4, 5, 6), rng) <= 2


def test_C4_vmap_and_jacrev(run, rng):
    q = smooth_motion(2, frames=6, joints=1, rng=rng)
    assert_same_rotation(torch.func.vmap(run)(q), run(q))
    weight = torch.rand(2, 6, 1, generator=rng, dtype=q.dtype)
    assert_same_rotation(torch.func.vmap(run)(q, weight), run(q, weight))
    alone = torch.stack([torch.autograd.functional.jacobian(run, item) for item in q])
    assert torch.allclose(torch.func.vmap(torch.func.jacrev(run))(q), alone, atol=1e-12)


def exported(run, shortest, rng):
    q = smooth_motion(2, frames=shortest + 5, rng=rng).contiguous()
    batch = torch.export.Dim("batch", min=1, max=10000)
    length = torch.export.Dim("frames", min=shortest, max=10000)
    return torch.export.export(run, (q,), dynamic_shapes=({0: batch, 1: length},)).module()


def test_C4_forward_derivatives_are_the_backward_ones(run, rng):
    """What is taken as given on the way back is taken as given on the way there."""
    q = smooth_motion(frames=14, rng=rng, step=0.4)
    step, seen = torch.randn(2, *q.shape, generator=rng, dtype=q.dtype).unbind(0)
    _, along = torch.func.jvp(run, (q,), (step,))
    _, back = torch.func.vjp(run, q)
    assert torch.allclose((along * seen).sum(), (back(seen)[0] * step).sum(), rtol=1e-6, atol=1e-9)


@pytest.mark.filterwarnings("ignore:.*get_attr.*:UserWarning")  # torch 2.6's own
def test_C5_export_with_a_dynamic_batch_and_length(windowed, rng, request):
    """Known limit: an exported lifting scheme of L levels takes 8 * 2^L frames and more."""
    if request.node.callspec.params["windowed"] in ONE_LENGTH:
        limit = pytest.mark.xfail(reason="the length is fixed", raises=FIXED, strict=True)
        request.applymarker(limit)
    shortest = 8 * 2**windowed.levels if isinstance(windowed, LiftingDenoiser) else 2
    program = exported(windowed, shortest, rng)
    for batch, frames in ((1, shortest), (3, shortest + 5), (1, 4096)):
        q = smooth_motion(batch, frames=1, rng=rng).expand(batch, frames, 3, 4).clone()
        turn = so3.exp(torch.full((3,), 0.5, dtype=q.dtype))
        q[:, frames // 2 :] = so3.compose(q[:, :1], turn)
        assert_same_rotation(program(q), windowed(q))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ONE_LENGTH, *RECURSIVE])
def test_C5_export_of_one_length_with_a_dynamic_batch(name, rng):
    run, q = FILTERS[name], smooth_motion(2, frames=7, rng=rng).contiguous()
    batch = torch.export.Dim("batch", min=1, max=10000)
    program = torch.export.export(run, (q,), dynamic_shapes=({0: batch},)).module()
    for items in (1, 2, 5):
        q = smooth_motion(items, frames=7, rng=rng).contiguous()
        assert_same_rotation(program(q), run(q))


@pytest.mark.slow
@pytest.mark.xfail(reason="the length is fixed", raises=FIXED, strict=True)
def test_C5_known_limit_recursive_filters_export_one_length(recursive, rng):
    exported(recursive, 2, rng)


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
