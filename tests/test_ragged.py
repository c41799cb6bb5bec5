"""Padded batches: every sequence as if it stood alone."""

import pytest
import torch
from filters_under_test import ALL
from motions import smooth_motion

from torchquat import BilateralFilter, GaussianFilter, Ragged

LENGTHS = torch.tensor([[9, 4, 9], [0, 1, 12]])


@pytest.mark.parametrize("name", ALL)
def test_each_as_if_alone_to_the_last_bit(name, rng):
    q = smooth_motion(2, 3, frames=12, rng=rng)
    weight = torch.rand(q.shape[:-1], generator=rng, dtype=q.dtype)
    found = Ragged(ALL[name])(q, LENGTHS, weight)
    for place in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)):
        length = int(LENGTHS[place])
        alone = ALL[name](q[place][:length], weight[place][:length])
        assert torch.equal(found[place][:length], alone)
        assert torch.equal(found[place][length:], q[place][length:])


def test_padding_may_be_anything_and_has_no_gradient(rng):
    q = smooth_motion(2, frames=8, rng=rng)
    padded = q.clone()
    padded[0, 5:] = torch.nan
    lengths = torch.tensor([5, 8])
    run = Ragged(BilateralFilter())
    assert torch.equal(run(padded, lengths)[0, :5], run(q, lengths)[0, :5])
    q.requires_grad_()
    run(q, lengths)[0, :5].cumsum(-1).sum().backward()
    assert (q.grad[0, 5:] == 0).all()
    assert (q.grad[0, :5] != 0).any()


def test_weights_broadcast(rng):
    q = smooth_motion(2, frames=8, rng=rng)
    weight = torch.rand(8, 1, generator=rng, dtype=q.dtype)
    lengths, run = torch.tensor([8, 3]), Ragged(GaussianFilter(1.0))
    assert torch.equal(run(q, lengths, weight), run(q, lengths, weight.expand(q.shape[:-1])))


@pytest.mark.parametrize("shape", [(2, 0, 3, 4), (2, 5, 0, 4), (0, 5, 3, 4), (2, 0, 5, 3, 4)])
def test_B1_nothing(shape):
    lengths = torch.full(shape[:-3], shape[-3])
    assert Ragged(GaussianFilter(1.0))(torch.zeros(shape), lengths).shape == shape


def test_one_sequence_alone(rng):
    q = smooth_motion(frames=8, rng=rng)
    run = Ragged(GaussianFilter(1.0))
    assert torch.equal(run(q, torch.tensor(8)), GaussianFilter(1.0)(q))


@pytest.mark.parametrize(
    ("lengths", "error", "message"),
    [
        ([5, 8], TypeError, "lengths must be a tensor of whole numbers, got list"),
        (torch.tensor([5.0, 8.0]), TypeError, "whole numbers, got torch.float32"),
        (torch.tensor([True, False]), TypeError, "whole numbers, got torch.bool"),
        (torch.tensor([5]), ValueError, r"lengths must have shape \(2,\), one a sequence of q"),
        (torch.tensor([5, 9]), ValueError, r"lengths must lie in \[0, 8\], got 9\."),
        (torch.tensor([-1, 8]), ValueError, r"lengths must lie in \[0, 8\], got -1\."),
    ],
)
def test_A23_wrong_lengths_are_named(lengths, error, message, rng):
    with pytest.raises(error, match=message):
        Ragged(GaussianFilter(1.0))(smooth_motion(2, frames=8, rng=rng), lengths)
