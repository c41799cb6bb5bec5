"""Models that leave PyTorch: C10 of the contract."""

import pytest
import torch
from test_contract_transforms import FILTERS, ONE_LENGTH, RECURSIVE

from torchquat import _running

export_onnx = pytest.importorskip(
    "export_onnx", reason="onnxruntime is not installed (extra: onnx)", exc_type=ImportError
)

NO_OPERATION = ("principal-components", "kernel-pca")
"""They ask for eigenvectors, which ONNX cannot find."""
EXPORTED = [name for name in FILTERS if name not in (*ONE_LENGTH, *RECURSIVE, *NO_OPERATION)]
QUIET = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")


def arguments(output, name, *more):
    return ["--output", str(output), "--config", f"configs/{name}.yaml", "--joints", "1", *more]


@QUIET
def test_C10_the_example_writes_a_model_that_onnxruntime_runs(tmp_path, capsys):
    more = ("--filter.init_args.sigma_t", "0.3")
    assert export_onnx.main(arguments(tmp_path / "model.onnx", "gaussian", *more)) == 0
    said = capsys.readouterr().out
    assert "GaussianFilter, opset 20" in said and "rad of PyTorch" in said


@QUIET
@pytest.mark.slow
@pytest.mark.parametrize("name", EXPORTED)
def test_C10_onnxruntime_agrees(name, tmp_path):
    run, path = FILTERS[name], tmp_path / "model.onnx"
    export_onnx.write_onnx(run, path, joints=2)
    assert export_onnx.worst_angle(run, path, joints=2) < 1e-5


@QUIET
@pytest.mark.slow
@pytest.mark.parametrize("name", [*ONE_LENGTH, *RECURSIVE, *NO_OPERATION])
def test_C10_what_is_not_supported_is_said(name, tmp_path):
    with pytest.raises(ValueError, match="not supported in ONNX"):
        export_onnx.write_onnx(FILTERS[name], tmp_path / "model.onnx", joints=2)


@QUIET
def test_C10_a_model_that_differs_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export_onnx, "write_onnx", lambda *_, **__: (tmp_path / "m").touch())
    monkeypatch.setattr(export_onnx, "worst_angle", lambda *_, **__: 2e-5)
    assert export_onnx.main(arguments(tmp_path / "m", "gaussian")) == 1
    assert "expected 1e-05 rad at most, got 2e-05" in capsys.readouterr().err


@pytest.mark.parametrize("rate", ["0", "-1", ".inf", ".nan"])
@pytest.mark.parametrize("name", ["butterworth", "median"])
def test_A23_a_frame_rate_is_positive(rate, name, tmp_path, capsys):
    assert export_onnx.main(arguments(tmp_path / "m.onnx", name, "--frame_rate", rate)) == 1
    assert "error: frame_rate must be finite and > 0, got" in capsys.readouterr().err


@pytest.mark.parametrize("length", [1, 2, 3, 37, 1500])
@pytest.mark.parametrize("dim", [0, 1, -1])
def test_running_values_made_by_doubling(length, dim, rng, monkeypatch):
    x = torch.randn(length, length if length < 50 else 2, 3, generator=rng).movedim(0, dim)
    sign = torch.where(x > 0, 1.0, -1.0)
    expected = (x.cummax(dim).values, x.cummin(dim).values, sign.cumprod(dim))
    monkeypatch.setattr(_running, "_exporting", lambda: True)
    made = (
        _running.running_maximum(x, dim),
        _running.running_minimum(x, dim),
        _running.running_product(sign, dim),
    )
    assert all(map(torch.equal, made, expected))
