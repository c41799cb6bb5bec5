"""On a GPU every filter gives what it gives on a CPU, and stays there."""

import copy

import pytest
import torch
from motions import BOUND, assert_same_rotation, smooth_motion

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


@pytest.fixture
def q(rng, dtype):
    q = smooth_motion(2, frames=41, step=0.3, rng=rng, dtype=dtype)
    q[0, 3:9, 1] = torch.nan
    q[1, :2, 2] = torch.inf
    q[1, 30, 0] = 0.0
    q[0, 20:] *= -1
    return q


def twins(run, dtype):
    """The filter on both devices, its parameters in the dtype of the signal."""
    here = copy.deepcopy(run).to(dtype)
    return here, copy.deepcopy(here).cuda()


def test_B14_the_same_as_on_a_cpu(run, q, rng):
    weight = torch.rand(q.shape[:-1], generator=rng, dtype=q.dtype)
    weight[1, 11:13] = 0.0
    here, there = twins(run, q.dtype)
    for confidence in (None, weight):
        result = there(q.cuda(), None if confidence is None else confidence.cuda())
        assert result.device.type == "cuda" and result.dtype == q.dtype
        assert_same_rotation(result.cpu(), here(q, confidence), max(BOUND[q.dtype], 1e-9))


def test_B18_the_same_twice(run, q):
    there = copy.deepcopy(run).cuda()
    assert torch.equal(there(q.cuda()), there(q.cuda()))


def test_A14_gradients_are_those_of_a_cpu(run, q):
    slopes = []
    for module, device in zip(twins(run, torch.float64), ("cpu", "cuda"), strict=True):
        leaf = q.to(device, torch.float64, copy=True).requires_grad_()
        module(leaf).cumsum(-1).sum().backward()
        slopes.append(leaf.grad.cpu())
    assert slopes[1].isfinite().all()
    assert torch.allclose(*slopes, rtol=1e-5, atol=1e-7)


def test_B14_a_weight_on_the_other_device_is_refused(run, q):
    with pytest.raises(ValueError, match="weight must be on cuda:0 as q, got cpu"):
        copy.deepcopy(run).cuda()(q.cuda(), torch.ones(41, 3, dtype=q.dtype))
