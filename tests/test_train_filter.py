"""Training: a seed says everything, and an interruption changes nothing."""

import pytest
import torch
import train_filter
from _learning_loop import Job, fit
from motions import smooth_motion

from torchquat import BilateralFilter, noise, so3


def batches(seed):
    """A draw that depends on the step alone."""

    def batch(step):
        rng = torch.Generator().manual_seed(1000 * seed + step)
        clean = smooth_motion(2, frames=16, rng=rng, dtype=torch.float32, step=0.05)
        return noise.gaussian(clean, 0.1, generator=rng), clean

    return batch


def job(steps=6, seed=0):
    return Job("job", BilateralFilter(1.0, 0.2, learnable=True), batches(seed), steps, 0.05, seed)


def test_an_interrupted_run_goes_on_as_if_it_had_not_been(tmp_path):
    whole, cut, resumed = job(), job(), job()
    fit(whole, tmp_path / "whole", every=2)

    def stop(step, batch=cut.batch):
        if step == 5:
            raise KeyboardInterrupt
        return batch(step)

    object.__setattr__(cut, "batch", stop)
    with pytest.raises(KeyboardInterrupt):
        fit(cut, tmp_path / "cut", every=2)
    fit(resumed, tmp_path / "cut", resume=True, every=2)
    for one, other in zip(whole.module.parameters(), resumed.module.parameters(), strict=True):
        assert torch.equal(one, other)
    logs = [(tmp_path / name / "job" / "scalars.csv").read_text() for name in ("whole", "cut")]
    assert logs[0] == logs[1]


def test_training_lowers_the_loss(tmp_path):
    trained = job(steps=30)
    seen, clean = batches(7)(0)
    before = so3.squared_distance(trained.module(seen), clean).mean().item()
    fit(trained, tmp_path)
    assert so3.squared_distance(trained.module(seen), clean).mean().item() < 0.95 * before


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    fit(job(steps=2), tmp_path)
    with pytest.raises(ValueError, match=r"made with .*'steps': 2.*, cannot go on .*'steps': 3"):
        fit(job(steps=3), tmp_path, resume=True)
    path = tmp_path / "job" / "checkpoint.pt"
    assert set(torch.load(path, weights_only=True)) == {"step", "settings", "module", "optimizer"}


def test_a_seed_reproduces_and_another_differs(tmp_path, capsys):
    tables = []
    for name, seed in (("a", "0"), ("b", "0"), ("c", "1")):
        out = tmp_path / name
        arguments = ["--parts", "regressor", "--quick", "--seed", seed, "--output", str(out)]
        assert train_filter.main(arguments) == 0
        tables.append((out / "table.txt").read_text())
    capsys.readouterr()
    assert tables[0] == tables[1]
    assert tables[0] != tables[2]
    assert "regressor, filter inside, learned" in tables[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--parts", "all"), "parts must be of bandwidths, blocks, regressor, got all"),
        (("--scale", "0"), "scale must be finite and > 0"),
        (("--clips", "/nowhere"), "/nowhere"),
    ],
)
def test_wrong_arguments_are_one_line(arguments, message, tmp_path, capsys):
    assert train_filter.main([*arguments, "--quick", "--output", str(tmp_path)]) == 1
    line = capsys.readouterr().err
    assert message in line
    assert line.count("\n") == 1
