"""A training loop in plain PyTorch: progress, log, checkpoints, resumption."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from _learning_log import Log
from torch import Tensor, nn
from tqdm import tqdm

from torchquat import so3

__all__ = ["Job", "fit", "loss_of"]

CHECKPOINT = "checkpoint.pt"
LOG_EVERY = 10  # [steps]
LARGEST_GRADIENT = 100.0  # norm beyond which a step is shortened


@dataclass(frozen=True)
class Job:
    """One thing to train.

    Attributes:
        name: Of its folder.
        module: From inputs to unit quaternions ``(B, T, J, 4)``.
        batch: Inputs and true rotations of a step. A draw depends on the step alone, so that a run
            that was interrupted goes on as if it had not been.
        steps: How many.
        rate: Learning rate at the start; it falls along a cosine.
        seed: What the batches were drawn with; only noted.
    """

    name: str
    module: nn.Module
    batch: Callable[[int], tuple[Tensor, Tensor]]
    steps: int
    rate: float
    seed: int


def fit(job: Job, folder: Path, *, resume: bool = False, every: int = 50) -> None:
    """Train the module of a job in place.

    Args:
        job: What.
        folder: Its own folder within, with checkpoint and log.
        resume: Go on from the checkpoint, if there is one.
        every: Steps between checkpoints.

    Raises:
        ValueError: If the checkpoint is that of another run.
    """
    path = folder / job.name / CHECKPOINT
    optimizer = torch.optim.Adam(job.module.parameters(), lr=job.rate)
    start = _load(job, optimizer, path) if resume and path.exists() else 0
    log = Log(path.parent, start)
    bar = tqdm(total=job.steps, initial=start, desc=job.name, unit="step", disable=None)
    try:
        for step in range(start, job.steps):
            scalars = _step(job, optimizer, step)
            if step % LOG_EVERY == 0 or step == job.steps - 1:
                log.write(step, scalars)
                bar.set_postfix(loss=f"{scalars['loss']:.2f} dB", refresh=False)
            if (step + 1) % every == 0 or step == job.steps - 1:
                _save(job, optimizer, step + 1, path)
            bar.update()
    finally:
        bar.close()
        log.close()


def loss_of(made: Tensor, clean: Tensor) -> Tensor:
    """Minus the PSNR [dB], mean over a batch: calm windows count as much as lively ones."""
    square = so3.squared_distance(made, clean).mean((-1, -2))
    return 10.0 * torch.log10(square / math.pi**2).mean()


def _step(job: Job, optimizer: torch.optim.Optimizer, step: int) -> dict[str, float]:
    for group in optimizer.param_groups:
        group["lr"] = 0.5 * job.rate * (1.0 + math.cos(math.pi * step / job.steps))
    seen, clean = job.batch(step)
    loss = loss_of(job.module(seen), clean)
    optimizer.zero_grad()
    loss.backward()
    norm = nn.utils.clip_grad_norm_(job.module.parameters(), LARGEST_GRADIENT)
    optimizer.step()
    shown = {"loss": loss, "gradient": norm, **_bandwidths(job.module)}
    return {name: float(value.detach()) for name, value in shown.items()}


def _bandwidths(module: nn.Module) -> dict[str, Tensor]:
    """Geometric means of all that is kept as a logarithm."""
    logs = {name: p for name, p in module.named_parameters() if "log_" in name}
    return {name.replace("log_", ""): p.mean().exp() for name, p in logs.items()}


def _settings(job: Job) -> dict[str, int | float]:
    return {"steps": job.steps, "rate": job.rate, "seed": job.seed}


def _save(job: Job, optimizer: torch.optim.Optimizer, step: int, path: Path) -> None:
    """Write beside, then rename: an interruption leaves the former checkpoint."""
    state = {
        "step": step,
        "settings": _settings(job),
        "module": job.module.state_dict(),
        "optimizer": optimizer.state_dict(),
    }
    beside = path.with_suffix(".part")
    torch.save(state, beside)
    beside.replace(path)


def _load(job: Job, optimizer: torch.optim.Optimizer, path: Path) -> int:
    """Put a checkpoint back; returns the next step."""
    state = torch.load(path, weights_only=True)
    if state["settings"] != _settings(job):
        raise ValueError(f"{path}: made with {state['settings']}, cannot go on {_settings(job)}.")
    try:
        job.module.load_state_dict(state["module"])
    except RuntimeError as error:
        raise ValueError(f"{path}: of another module: {error}") from error
    optimizer.load_state_dict(state["optimizer"])
    return state["step"]
