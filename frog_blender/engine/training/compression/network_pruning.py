"""Pruning hidden units of the deformation network whose part in the images the others can take over.

Optimal brain surgeon (Hassibi and Stork, 1993) for the layer that the outputs read: removing a unit and correcting the
others' weights in the best way costs w^2 / (2 [H^-1]_uu), with H the second moments of the units' values. Here the
moments are weighted by how much an image changes with each output of each Gaussian, so that the cost is in images.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...capture.capture import Capture
from ...model.frog import Frog
from ...rasterizer import rasterize
from ...scene.compression_report import StepKind
from ..optimize.half_resolution import halved_capture
from ..optimize.hooks import Training
from .context import CompressionContext, Proposal
from .sensitivity import SampledView, backward_by_signs
from .validation import ValidationEvaluator

STEP, LEAST = 4, 16  # units that are removed together, and that stay
_GROWTH = 1.4  # of the expected cost, for each STEP
_DAMPING = 1e-6  # of the mean second moment: units that always have the same values


@dataclass(frozen=True)
class PrunedLayer:
    """The output layer after some units were removed.

    Attributes:
        units: (U',) indices of those that stay, ascending.
        weight, bias: (outputs, U) with zeros for those that were removed, and (outputs,).
    """

    units: torch.Tensor
    weight: torch.Tensor
    bias: torch.Tensor


def prune_hidden_units(
    context: CompressionContext,
    evaluator: ValidationEvaluator,
    views: Sequence[SampledView],
    generator: torch.Generator,
) -> Iterator[Proposal]:
    """Units of the first layer, STEP at a time.

    The papers' networks, whose heads have layers of their own, and dual ones stay as they are.
    """
    training, model, settings = context.training, context.training.gaussians.model, context.settings
    if not isinstance(model, Frog) or not context.num_dynamic or not model.deformation.can_narrow:
        return
    if model.settings.hidden_width <= LEAST:
        return
    weight, bias = model.deformation.output_weight.detach(), model.deformation.output_bias.detach()
    step = math.ceil(len(views) / settings.num_unit_views)
    every = max(1, context.num_dynamic // settings.num_unit_gaussians)
    layers = without_units(visible_moments(training, model, views[step // 2 :: step], every, generator), weight, bias)

    def loss(number: int) -> float:
        arrays = vars(layers[number - 1])

        def change(key: str, value: torch.Tensor) -> torch.Tensor:
            return arrays[key.rpartition("_")[2]] if key.startswith("deformation.output_") else value

        return evaluator.now - context.psnr_with(change)

    def apply(number: int) -> None:
        weight.copy_(layers[number - 1].weight)
        bias.copy_(layers[number - 1].bias)
        training.gaussians.optimizer.keep_units(model, layers[number - 1].units)

    yield Proposal(
        StepKind.NETWORK_WIDTH,
        apply,
        lambda: model.settings.hidden_width,
        loss,
        lambda: context.gaussians_at(0.5),
        settings.max_width_loss,
        0.2 * settings.max_width_loss * _GROWTH ** np.arange(len(layers)),
    )


def visible_moments(
    training: Training, model: Frog, views: Sequence[SampledView], every: int, generator: torch.Generator
) -> torch.Tensor:
    """(outputs, U + 1, U + 1) float64 second moments of the units' values and a constant 1 over dynamic Gaussians and
    views, weighted for each output by the square of what the image changes with that Gaussian's output.

    In double precision: single rounds by more than what tells the least units apart.

    Args:
        every: one Gaussian of so many is taken in each view.
    """
    capture = halved_capture(training.capture)
    moments = torch.zeros((), dtype=torch.float64, device=training.gaussians.device)
    for number, view in enumerate(views):
        some = slice(number % every, None, every)  # others in each view, so that their errors differ
        with torch.no_grad():
            temporal = model.temporal_embedding(view.time, training.schedule_state())
            hidden = model.deformation.hidden(temporal, model.canonical.embeddings[some])
        values = torch.cat([hidden, hidden.new_ones(len(hidden), 1)], dim=1).double()
        squares = output_sensitivities(training, model, capture, view, generator)[some].double().square()
        moments = moments + torch.stack([(values * by[:, None]).T @ values for by in squares.T])
    return moments


def output_sensitivities(
    training: Training, model: Frog, capture: Capture, view: SampledView, generator: torch.Generator
) -> torch.Tensor:
    """(M, outputs) how much a view's image in ``capture`` changes with each output of the network for each dynamic
    Gaussian: estimates (see ``backward_by_signs``). Leaves the model no gradient."""
    schedules = training.schedule_state()
    temporal = model.temporal_embedding(view.time, schedules)
    gaussians, changes = model.deform_reference(temporal, schedules, model.canonical.sh.shape[1])
    for change in changes.values():
        change.retain_grad()
    image = rasterize(gaussians, capture.cameras[view.camera], capture.background)
    backward_by_signs(image, generator)
    model.zero_grad(set_to_none=True)
    gradients = []
    for name in model.deformation.sizes:
        gradient = changes[name].grad
        assert gradient is not None
        gradients.append(gradient * model.settings.motion_unit if name == "means" else gradient)
    return torch.cat(gradients, dim=1)


def without_units(moments: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> list[PrunedLayer]:
    """An output layer after STEP, 2 STEP, ... units were removed, with LEAST of them at least; fewer the first time
    where there are not a multiple of STEP.

    Args:
        moments: (outputs, U + 1, U + 1) see visible_moments.
        weight, bias: (outputs, U) and (outputs,).
    """
    count = weight.shape[1]
    diagonal = moments.diagonal(dim1=1, dim2=2)
    least = torch.finfo(torch.float64).tiny ** 0.5  # for outputs that no image shows
    damping = _DAMPING * diagonal.mean(1, keepdim=True) + least
    inverse = torch.linalg.inv(moments + torch.diag_embed(damping.expand_as(diagonal)))
    layer = torch.cat([weight, bias[:, None]], dim=1).double()
    there = torch.ones(count, dtype=torch.bool, device=weight.device)
    found = []
    for stay in range(count - 1, LEAST - 1, -1):
        spread = inverse.diagonal(dim1=1, dim2=2)[:, :count]
        cost = torch.where(there, (layer[:, :count].square() / spread).sum(0), torch.inf)
        unit = int(cost.argmin())
        there[unit] = False
        row = inverse[:, unit] / inverse[:, unit, unit, None]
        layer = layer - layer[:, unit, None] * row
        inverse = inverse - inverse[:, :, unit, None] * row[:, None]
        if stay % STEP == 0:
            left = layer.to(weight.dtype) * torch.cat([there, there.new_ones(1)])
            found.append(PrunedLayer(there.nonzero().squeeze(1), left[:, :-1].contiguous(), left[:, -1].contiguous()))
    return found
