"""Formulas with a backward pass of their own.

It is used where operations are recorded one by one. Second derivatives, compilers and function
transforms get the formula itself.
"""

from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from torch import Tensor

from torchquat._eager import recorded

__all__ = ["Formula", "Planes", "PullBack", "gradients", "run"]

Planes = tuple[Tensor, ...]

Formula = Callable[..., Planes]
"""From planes to planes."""

PullBack = Callable[[Planes, Planes, Planes], Planes]
"""From the inputs, the outputs and the gradients of these to the gradients of the inputs."""


def run(formula: Formula, pull_back: PullBack, *inputs: Tensor, keep: bool = False) -> Planes:
    """Evaluate a formula; where a backward pass is recorded, with the one given.

    Args:
        formula: What is evaluated.
        pull_back: Its backward pass.
        inputs: What goes in.
        keep: Keep the outputs for the backward pass, which gets none of them otherwise.
    """
    if not recorded(*inputs):
        return formula(*inputs)
    return cast(Planes, _Recorded.apply(formula, pull_back, keep, *inputs))


class _Recorded(torch.autograd.Function):
    """A formula whose backward pass is given."""

    @staticmethod
    def forward(
        ctx: Any, formula: Formula, pull_back: PullBack, keep: bool, *inputs: Tensor
    ) -> Planes:
        ctx.formula, ctx.pull_back = formula, pull_back
        outputs = formula(*inputs)
        ctx.inputs = len(inputs)
        ctx.save_for_backward(*inputs, *(outputs if keep else ()))
        return outputs

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        saved: Planes = ctx.saved_tensors
        inputs, results = saved[: ctx.inputs], saved[ctx.inputs :]
        if torch.is_grad_enabled():  # a derivative of this one will be asked for
            # under names of their own: one may depend on another, which is not for here to follow
            inputs = [x.view_as(x) for x in inputs]
            outputs = ctx.formula(*inputs)
            found = gradients(outputs, slopes, inputs, create_graph=True)
            return None, None, None, *found
        slopes = tuple(slope.contiguous() for slope in slopes)
        return None, None, None, *ctx.pull_back(inputs, results, slopes)


def gradients(
    outputs: Sequence[Tensor],
    slopes: Sequence[Tensor],
    inputs: Sequence[Tensor | None],
    *,
    create_graph: bool = False,
) -> list[Tensor | None]:
    """Gradient of every input that wants one and has one."""
    ends = [(y, g) for y, g in zip(outputs, slopes, strict=True) if y.requires_grad]
    wanted = [x for x in inputs if x is not None and x.requires_grad]
    if not ends or not wanted:
        return [None for _ in inputs]
    ys, gs = zip(*ends, strict=True)
    found = iter(torch.autograd.grad(ys, wanted, gs, create_graph=create_graph, allow_unused=True))
    return [next(found) if x is not None and x.requires_grad else None for x in inputs]
