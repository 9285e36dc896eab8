"""Making the deformation network narrower: units leave whose part in the images the others can take over.

Optimal brain surgeon (Hassibi and Stork, 1993) for the layer that the outputs read: leaving a unit out and correcting
the others' weights in the best way costs w^2 / (2 [H^-1]_uu), with H the second moments of the units' values. Here the
moments are weighed by how much an image changes with each Gaussian's each output, so that the cost is in images.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from ...capture.capture import Capture
from ...model.frog import Frog
from ...rasterizer import rasterize
from ..optimize.gaussian_order import gaussians_at
from ..optimize.half_resolution import halved_capture
from .sensitivity import SampledView, backward_by_signs
from .validation import ValidationEvaluator, largest_count_within

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer
    from .schedule import CompressionSchedule

ALLOWED_WIDTH_LOSS = 0.01
"""dB that a narrower network may cost on the withheld images; no step makes it up."""
STEP, LEAST = 4, 16  # units that leave together, and that stay
_LOOKS, _GAUSSIANS = (
    12,
    2048,
)  # looks that units are measured in, at half the pixels a side, and those that move in each
_GROWTH = 1.4  # of what narrowing costs, for each STEP
_DAMPING = 1e-6  # of the mean second moment: units that always have the same values


@dataclass(frozen=True)
class Narrower:
    """The output layer after some units left.

    Attributes:
        units: (U',) indices of those that stay, ascending.
        weight, bias: (outputs, U) with zeros for those that left, and (outputs,).
    """

    units: torch.Tensor
    weight: torch.Tensor
    bias: torch.Tensor


def narrow(
    rounds: CompressionSchedule,
    trainer: Trainer,
    judge: ValidationEvaluator,
    looks: Sequence[SampledView],
    generator: torch.Generator,
) -> None:
    """Leaves out units of the first layer, STEP at a time, as many as the withheld images do not miss.

    The papers' networks, whose heads have layers of their own, and dual ones stay as they are.
    """
    model = trainer.model
    if not isinstance(model, Frog) or not model.canonical.num_dynamic or not model.deformation.can_narrow:
        return
    if model.settings.hidden_width <= LEAST:
        return
    weight, bias = model.deformation.output_weight.detach(), model.deformation.output_bias.detach()
    step = math.ceil(len(looks) / _LOOKS)
    some = looks[step // 2 :: step]
    narrower = without_units(visible_moments(trainer, model, some, generator), weight, bias)

    def loss_of(number: int) -> float:
        arrays = vars(narrower[number - 1])

        def change(key: str, value: torch.Tensor) -> torch.Tensor:
            return arrays[key.rpartition("_")[2]] if key.startswith("deformation.output_") else value

        return judge.now - rounds.psnr_with(trainer, change)

    expected = 0.2 * ALLOWED_WIDTH_LOSS * _GROWTH ** np.arange(len(narrower))
    number, loss = largest_count_within(loss_of, expected, ALLOWED_WIDTH_LOSS)
    if not number:
        return
    chosen = narrower[number - 1]

    def width() -> int:
        return model.settings.hidden_width

    with rounds.noted("network width", trainer, width, lambda: gaussians_at(trainer, 0.5), loss):
        weight.copy_(chosen.weight)
        bias.copy_(chosen.bias)
        trainer.optimizer.keep_units(model, chosen.units)
    judge.accept(loss)


def visible_moments(
    trainer: Trainer, model: Frog, looks: Sequence[SampledView], generator: torch.Generator
) -> torch.Tensor:
    """(outputs, U + 1, U + 1) float64 second moments of the units' values and a constant 1 over Gaussians that move and
    the looks, for each output weighed by the square of what the look's image changes with that Gaussian's output.

    In double precision: single rounds by more than what tells the least units apart.
    """
    every, capture = max(1, model.canonical.num_dynamic // _GAUSSIANS), halved_capture(trainer.capture)
    moments = torch.zeros((), dtype=torch.float64, device=trainer.device)
    for number, look in enumerate(looks):
        some = slice(number % every, None, every)  # others in each look: what one estimates badly, others do not
        with torch.no_grad():
            temporal = model.temporal_embedding(look.time, trainer.schedule_state(trainer.progress))
            hidden = model.deformation.hidden(temporal, model.canonical.embeddings[some])
        values = torch.cat([hidden, hidden.new_ones(len(hidden), 1)], dim=1).double()
        squares = sensitivities(trainer, model, capture, look, generator)[some].double().square()
        moments = moments + torch.stack([(values * by[:, None]).T @ values for by in squares.T])
    return moments


def sensitivities(
    trainer: Trainer, model: Frog, capture: Capture, look: SampledView, generator: torch.Generator
) -> torch.Tensor:
    """(M, outputs) how much a look's image in ``capture`` changes with each output of the network for each Gaussian
    that moves: estimates (see motion.backward_by_signs). Leaves the model no gradient."""
    schedule_state = trainer.schedule_state(trainer.progress)
    temporal = model.temporal_embedding(look.time, schedule_state)
    gaussians, changes = model.deform_reference(temporal, schedule_state, model.canonical.sh.shape[1])
    for change in changes.values():
        change.retain_grad()
    image = rasterize(gaussians, capture.cameras[look.camera], capture.background)
    backward_by_signs(image, generator)
    model.zero_grad(set_to_none=True)
    gradients = []
    for name in model.deformation.sizes:
        gradient = changes[name].grad
        assert gradient is not None
        gradients.append(gradient * model.settings.motion_unit if name == "means" else gradient)
    return torch.cat(gradients, dim=1)


def without_units(moments: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> list[Narrower]:
    """What is left of an output layer after STEP, 2 STEP, ... units left, with LEAST of them at least; the first time
    fewer leave where there are not a multiple of STEP.

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
            found.append(Narrower(there.nonzero().squeeze(1), left[:, :-1].contiguous(), left[:, -1].contiguous()))
    return found
