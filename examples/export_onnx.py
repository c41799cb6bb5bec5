"""Write a filter as an ONNX model, and run it in onnxruntime to see that it does the same.

python examples/export_onnx.py [--config bilateral] [--filter.init_args.sigma_g 0.3]
       [--joints 24] [--frame_rate 30] --output FILTER.onnx

The model takes float32 quaternions ``q`` (batch, frames, joints, 4) of any batch and length, and
gives as many; missing frames (NaN, zeros) come back filled. Needs the extra ``onnx``.
"""

import io
import logging
import math
import re
import sys
import warnings
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import jsonargparse
import onnxruntime
import torch
from _command import run
from _filter_config import find_config, read_config
from torch import Tensor, nn
from torch._dynamo.exc import UserError
from tqdm import tqdm

from torchquat import LiftingDenoiser, so3
from torchquat._running import LONGEST

OPSET = 20
TOLERANCE = 1e-5
"""How far the model may be from the filter [rad]."""


def write_onnx(run: nn.Module, path: Path, *, joints: int) -> None:
    """Write a filter as a model with an open batch and length.

    Args:
        run: Filter of ``(batch, frames, joints, 4)``.
        path: File to write.
        joints: How many joints the model takes.

    Raises:
        ValueError: If ONNX cannot express what the filter does.
    """
    frames = shortest(run) + 5
    q = _motion(3, frames, joints, torch.Generator().manual_seed(0))
    shapes = {
        0: torch.export.Dim("batch", min=1, max=2**16),
        1: torch.export.Dim("frames", min=shortest(run), max=LONGEST),
    }
    name = type(run).__name__
    try:
        program = torch.export.export(run, (q,), dynamic_shapes=(shapes,))
    except UserError:
        raise ValueError(f"{name}: not supported in ONNX: its program has one length") from None
    try:
        with redirect_stdout(io.StringIO()):  # the exporter prints its progress
            model = torch.onnx.export(
                program, (), dynamo=True, opset_version=OPSET, input_names=["q"], output_names=["y"]
            )
    except torch.onnx.errors.OnnxExporterError as error:
        missing = re.search(r"No ONNX function found for <OpOverload\(op='([\w.]+)'", str(error))
        reason = f"ONNX has no {missing[1]}" if missing else str(error).splitlines()[0]
        raise ValueError(f"{name}: not supported in ONNX: {reason}") from None
    if model is None:  # as the signature allows, for the old exporter
        raise ValueError(f"{name}: not supported in ONNX")
    path.parent.mkdir(parents=True, exist_ok=True)
    model.save(path)


def worst_angle(run: nn.Module, path: Path, *, joints: int) -> float:
    """The largest angle between what a filter and its model make of random motions [rad].

    Batches and lengths are others than the model was made with, and some frames are missing.
    """
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    rng = torch.Generator().manual_seed(1)
    worst = 0.0
    for batch, frames in ((1, shortest(run)), (2, shortest(run) + 3), (5, 301)):
        q = _motion(batch, frames, joints, rng)
        q[:, frames // 2] = torch.nan
        (found,) = session.run(None, {"q": q.numpy()})
        with torch.inference_mode():
            angle = so3.distance(torch.as_tensor(found).double(), run(q).double())
        worst = max(worst, float(angle.max()))
    return worst


def shortest(run: nn.Module) -> int:
    """The fewest frames that an exported program takes."""
    return 8 * 2**run.levels if isinstance(run, LiftingDenoiser) else 2


def _motion(batch: int, frames: int, joints: int, rng: torch.Generator) -> Tensor:
    """Random walks ``(batch, frames, joints, 4)``, float32."""
    steps = torch.randn(batch, frames, joints, 3, generator=rng, dtype=torch.float64)
    return so3.exp(0.1 * steps.cumsum(1)).float().contiguous()


def _export(arguments: jsonargparse.Namespace) -> int:
    if arguments.joints < 1:
        raise ValueError(f"joints must be >= 1, got {arguments.joints}.")
    if not 0 < arguments.frame_rate < math.inf:
        raise ValueError(f"frame_rate must be finite and > 0, got {arguments.frame_rate}.")
    chosen = arguments.filter
    config = read_config(find_config(arguments.config), chosen.class_path, chosen.init_args)
    filtering = config.build(arguments.frame_rate).float()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # about packages that are not needed
    with warnings.catch_warnings(), tqdm(total=2, unit="step", disable=None) as progress:
        warnings.simplefilter("ignore")  # the exporter's own
        write_onnx(filtering, arguments.output, joints=arguments.joints)
        progress.update()
        worst = worst_angle(filtering, arguments.output, joints=arguments.joints)
        progress.update()
    print(
        f"{arguments.output}: {type(filtering).__name__}, opset {OPSET}, "
        f"{arguments.output.stat().st_size / 1e3:,.0f} kB, onnxruntime "
        f"{onnxruntime.__version__} within {worst:.1e} rad of PyTorch"
    )
    if not worst <= TOLERANCE:
        raise ValueError(f"{arguments.output}: expected {TOLERANCE:.0e} rad at most, got {worst}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Export one filter; returns the exit status."""
    parser = jsonargparse.ArgumentParser(
        description="Write a filter as an ONNX model, and check it.", exit_on_error=False
    )
    parser.add_argument("--config", default="bilateral", help="preset, or YAML with a filter")
    parser.add_argument("--filter.class_path", help="another filter than the config's")
    parser.add_argument(
        "--filter.init_args", type=dict[str, Any], default={}, help="single arguments of the filter"
    )
    parser.add_argument("--joints", type=int, default=24, help="how many the model takes")
    parser.add_argument(
        "--frame_rate", type=float, default=30.0, help="that times and cut-offs are converted with"
    )
    parser.add_argument("--output", type=Path, required=True, help="ONNX file to write")
    return run(parser, argv, _export)


if __name__ == "__main__":
    sys.exit(main())
