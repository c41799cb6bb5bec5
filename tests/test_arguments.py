"""What filters are called with: defaults, ranges, and a function for every module."""

import pytest
import torch
from filter_arguments import NEEDED, PAIRS, RANGES
from motions import assert_same_rotation, random_rotations, smooth_motion
from torch import nn

import torchquat as tq


def rough(rng):
    """A motion with wild frames, gaps and confidences."""
    q = smooth_motion(2, frames=40, rng=rng)
    q[:, ::9] = random_rotations(2, 5, 3, rng=rng)
    q[0, 12:15, 1] = torch.nan
    weight = 0.1 + torch.rand(2, 40, 3, generator=rng, dtype=q.dtype)
    weight[1, 20:23] = 0.0
    return q, weight


PER_JOINT = [
    ("gaussian", "sigma_t"),
    ("bilateral", "sigma_t"),
    ("bilateral", "sigma_g"),
    ("nonlocal", "sigma"),
    ("kalman", "process_noise"),
    ("kalman", "measurement_noise"),
    ("local-spectrum", "sigma"),
    ("low-rank", "sigma"),
]


@pytest.mark.parametrize(("name", "key"), PER_JOINT)
def test_one_value_or_one_per_joint(name, key, rng):
    _, function, given, _ = PAIRS[name]
    q, weight = rough(rng)
    expected = function(q, weight, **given | {key: 0.7})
    tensors = (torch.tensor(each, dtype=torch.float64) for each in (0.7, [0.7] * 3))
    for values in ([0.7], [0.7] * 3, *tensors):
        assert_same_rotation(function(q, weight, **given | {key: values}), expected, 1e-9)
    with pytest.raises(ValueError, match=rf"^{key} must be one value or one per joint \(3\), got"):
        function(q, weight, **given | {key: [0.7, 0.7]})


@pytest.mark.parametrize(("name", "key"), [*((name, None) for name in PAIRS), *PER_JOINT])
def test_B11_functions_make_nothing_of_default_dtype_or_device(name, key, rng):
    """A default device is often set in scripts; what is made on this one could not be used."""
    q, weight = (each.float() for each in rough(rng))
    function, given = PAIRS[name].function, dict(PAIRS[name].given)
    if key is not None:
        given[key] = [0.6, 0.7, 0.8]
        given.pop("radius", None)  # found from the bandwidth then
    expected = function(q, weight, **given)
    with torch.device("meta"):
        assert torch.equal(function(q, weight, **given), expected)
    torch.set_default_dtype(torch.float64)
    try:
        found = function(q, weight, **given)
    finally:
        torch.set_default_dtype(torch.float32)
    assert found.dtype == torch.float32 and torch.equal(found, expected)


@pytest.mark.parametrize(
    ("sigma_t", "radius"),
    [(2 / 3, 2), (100 * 0.07, 21), (torch.tensor(2 / 3), 2), (1.001, 4), ([1.7, 0.1, 0.1], 6)],
)
def test_windows_hold_three_bandwidths(sigma_t, radius):
    """And no frame more where 3 * 2 / 3 is rounded up, or 100 * 0.07."""
    assert tq.GaussianFilter(sigma_t).radius == radius
    assert tq.BilateralFilter(sigma_t, 0.1).radius == radius


@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("one-euro", {"beta": 0.0}),
        ("kernel-pca", {"landmarks": 1, "iterations": 0}),
        ("median", {"radius": 0, "iterations": 0}),
        ("nonlocal", {"patch_radius": 0, "search_radius": 0}),
        ("gaussian", {"radius": 0}),
        ("bilateral", {"radius": 0, "iterations": 0}),
        ("savitzky-golay", {"radius": 0, "order": 0}),
        ("lifting", {"levels": 0, "rule": "universal"}),
    ],
)
def test_the_least_that_is_allowed(name, least, rng):
    module, function, given, _ = PAIRS[name]
    q, weight = rough(rng)
    given = given | least
    assert_same_rotation(module(**given).double()(q, weight), function(q, weight, **given), 1e-6)


def test_every_filter_is_here():
    others = {"BezierPredict", "HaarPredict", "HaarUpdate", "LearnedPredict", "LearnedUpdate"}
    others |= {"LiftingStep", "LiftingTransform", "LinearPredict", "LinearUpdate"}
    others |= {"PatchEmbedding", "Ragged", "RepresentationAdapter", "SquadPredict"}
    found = {name for name in tq.__all__ if isinstance(getattr(tq, name), type)}
    modules = {name for name in found if issubclass(getattr(tq, name), nn.Module)}
    assert modules - others == {pair.module.__name__ for pair in PAIRS.values()}


@pytest.mark.parametrize("name", PAIRS)
def test_a_module_is_its_function(name, rng):
    module, function, given, _ = PAIRS[name]
    q, weight = rough(rng)
    run = module(**given).double()
    assert_same_rotation(run(q, weight), function(q, weight, **given), 1e-6)
    assert_same_rotation(run(q), function(q, None, **given), 1e-6)
    assert repr(run).startswith(module.__name__)


@pytest.mark.parametrize("name", PAIRS)
def test_defaults(name, rng):
    module, function, _, defaults = PAIRS[name]
    q, weight = rough(rng)
    needed = {key: defaults[key] for key in NEEDED.get(name, ())}
    expected = module(**defaults)(q, weight)
    assert torch.equal(module(**needed)(q, weight), expected)
    if name in ("gaussian", "bilateral"):  # as functions they have no default bandwidths
        needed = {key: value for key, value in defaults.items() if key.startswith("sigma")}
    # bandwidths of modules are stored in single precision
    assert_same_rotation(function(q, weight, **needed), expected, 1e-5)


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
@pytest.mark.parametrize("name", ["gaussian", "bilateral", "nonlocal"])
def test_A23_tensors_out_of_range_are_named_where_they_can_be_seen(name, value, rng):
    _, function, given, _ = PAIRS[name]
    key = next(key for key in given if key.startswith("sigma"))
    with pytest.raises(ValueError, match=f"^{key} must be finite and > 0, got"):
        function(*rough(rng), **{**given, key: torch.tensor([1.0, value, 1.0])})


@pytest.mark.parametrize("name", [name for name in PAIRS if "learnable" in PAIRS[name].defaults])
def test_learnable(name):
    module, _, given, _ = PAIRS[name]
    fixed, free = (module(**given, learnable=learnable) for learnable in (False, True))
    assert not list(fixed.parameters()) and not list(module(**given).parameters())
    learned = dict(free.named_parameters())
    assert learned and all(p.requires_grad for p in learned.values())
    assert set(free.state_dict()) == set(learned) >= set(fixed.state_dict())


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        (name, key, value)
        for name, ranges in RANGES.items()
        for key, values in ranges.items()
        for value in values
    ],
)
def test_A23_values_out_of_range_are_named(name, key, value, rng):
    """Or ``TypeError``, where a count is none."""
    module, function, given, _ = PAIRS[name]
    error = TypeError if value in (1.5, "3") and key != "components" else ValueError
    with pytest.raises(error, match=rf"^{key} must "):
        module(**given | {key: value})
    with pytest.raises(error, match=rf"^{key} must "):
        function(smooth_motion(rng=rng), None, **given | {key: value})
