"""A network's backward pass through the Gaussians that a step has drawn, and no others.

Most steps draw a part of an image, and most Gaussians send no gradient back. What a baseline's network says of one
Gaussian depends on no other, so the pass forwards keeps nothing, and the pass backwards repeats it for the few rows
that matter (as FRoG's native one leaves the others out): the same gradients for a fraction of the time.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from ...rasterizer.torch_types import Context


class _VisibleRows(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Context, network: nn.Module, time: float, means: torch.Tensor, *parameters: torch.Tensor
    ) -> torch.Tensor:
        ctx.network, ctx.time = network, time
        ctx.save_for_backward(means, *parameters)
        result: torch.Tensor = network(means, time)
        return result

    @staticmethod
    def backward(ctx: Context, *by: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        means, *parameters = ctx.saved_tensors
        (gradient,) = by
        rows = gradient.any(dim=1).nonzero().squeeze(1)
        wants_means = ctx.needs_input_grad[2]
        some = means[rows].requires_grad_(wants_means)
        with torch.enable_grad():
            output = ctx.network(some, ctx.time)
        inputs = [*parameters, some] if wants_means else parameters
        found = list(torch.autograd.grad(output, inputs, gradient[rows]))
        to_means = None
        if wants_means:
            to_means = torch.zeros_like(means)
            to_means[rows] = found.pop()
        return None, None, to_means, *found


def through_visible_rows(network: nn.Module, means: torch.Tensor, time: float) -> torch.Tensor:
    """``network(means, time)``, (N, outputs) of means (N, 3); every parameter of the network must take part in it."""
    apply: Callable[..., torch.Tensor] = _VisibleRows.apply
    return apply(network, time, means, *network.parameters())
