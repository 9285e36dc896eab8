"""Making the deformation network narrower: units leave whose part in the pictures the others can take over.

Optimal brain surgeon (Hassibi and Stork, 1993) for the layer that the outputs read: leaving a unit out and correcting
the others' weights in the best way costs w^2 / (2 [H^-1]_uu), with H the second moments of the units' values. Here the
moments are weighed by how much a picture changes with each Gaussian's each output, so that the cost is in pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from ..model.frog import Frog
from ..rasterizer import rasterize
from .motion import Look
from .validation import most_within

if TYPE_CHECKING:
    from .parsimony import Parsimony
    from .trainer import Trainer

ALLOWED_WIDTH_LOSS = 0.03
"""dB that a narrower network may cost on the withheld pictures; the rest of the training makes it up."""
STEP = 16  # units that the native library computes at once
_LOOKS = 8  # of those that Gaussians are measured on: units have thousands of Gaussians to be judged by
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


def narrow(rounds: Parsimony, trainer: Trainer, looks: Sequence[Look], generator: torch.Generator) -> None:
    """Leaves out units of the first layer, STEP at a time, as many as the withheld pictures do not miss.

    The papers' networks, whose heads have layers of their own, and dual ones stay as they are.
    """
    model = trainer.model
    if not isinstance(model, Frog) or not model.canonical.moving or not model.deformation.can_narrow:
        return
    weight, bias = model.deformation.output_weight.detach(), model.deformation.output_bias.detach()
    narrower = without_units(visible_moments(trainer, model, looks[:_LOOKS], generator), weight, bias)
    psnr = rounds.judge(trainer).before

    def loss_of(number: int) -> float:
        arrays = vars(narrower[number - 1])

        def change(key: str, value: torch.Tensor) -> torch.Tensor:
            return arrays[key.rpartition("_")[2]] if key.startswith("deformation.output_") else value

        return psnr - rounds.psnr_with(trainer, change)

    number, loss = most_within(loss_of, len(narrower), ALLOWED_WIDTH_LOSS, first=1)
    if not number:
        return
    chosen = narrower[number - 1]
    with rounds.noted(
        *("network width", trainer, lambda: model.settings.hidden_width),
        *(lambda: trainer.gaussians_at(0.5, trainer.progress), loss),
    ):
        weight.copy_(chosen.weight)
        bias.copy_(chosen.bias)
        trainer.optimizer.keep_units(model, chosen.units)


def visible_moments(trainer: Trainer, model: Frog, looks: Sequence[Look], generator: torch.Generator) -> torch.Tensor:
    """(outputs, U + 1, U + 1) float64 second moments of the units' values and a constant 1 over the Gaussians that move
    and the looks, for each output weighed by the square of what the look's picture changes with that Gaussian's output.

    What a picture changes with an output it changes with the canonical attribute that the output is added to. One
    backward pass with random signs gives it for all Gaussians at once (see motion.Motion).
    """
    moments = torch.zeros(0, device="cpu")
    for look in looks:
        with torch.no_grad():
            temporal = model.temporal_embedding(look.time, trainer.progressing(trainer.progress))
            hidden = model.deformation.hidden(temporal, model.canonical.embeddings)
            values = torch.cat([hidden, hidden.new_ones(len(hidden), 1)], dim=1)
        squares = _sensitivities(trainer, model, look, generator).square()
        found = torch.stack([(values * by[:, None]).T @ values for by in squares.T]).double()
        moments = moments + found if len(moments) else found
    return moments


def _sensitivities(trainer: Trainer, model: Frog, look: Look, generator: torch.Generator) -> torch.Tensor:
    """(M, outputs) estimates; leaves the model no gradient."""
    canonical, capture = model.canonical, trainer.capture
    gaussians, _ = trainer.gaussians_at(look.time, trainer.progress)
    image = rasterize(gaussians, capture.cameras[look.camera], capture.background)
    signs = 2.0 * torch.randint(2, image.rgb.shape, generator=generator, device="cpu") - 1
    image.rgb.backward(signs.to(image.rgb.device))
    parts = []
    for name, size in model.deformation.sizes.items():
        gradient = getattr(canonical, name).grad[: canonical.moving].reshape(canonical.moving, -1)[:, :size]
        parts.append(gradient * model.settings.motion_unit if name == "means" else gradient)
    model.zero_grad(set_to_none=True)
    return torch.cat(parts, dim=1)


def without_units(moments: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> list[Narrower]:
    """What is left of an output layer after STEP, 2 STEP, ... units, at least STEP of them.

    Args:
        moments: (outputs, U + 1, U + 1) see visible_moments.
        weight, bias: (outputs, U) and (outputs,).
    """
    count = weight.shape[1]
    diagonal = moments.diagonal(dim1=1, dim2=2)
    damping = _DAMPING * diagonal.mean(1, keepdim=True) + torch.finfo(torch.float64).tiny ** 0.5
    inverse = torch.linalg.inv(moments + torch.diag_embed(damping.expand_as(diagonal)))
    layer = torch.cat([weight, bias[:, None]], dim=1).double()
    there = torch.ones(count, dtype=torch.bool, device=weight.device)
    found = []
    for left in range(1, max(0, count - STEP) + 1):
        spread = inverse.diagonal(dim1=1, dim2=2)[:, :count]
        cost = (layer[:, :count].square() / spread).sum(0)
        unit = int(torch.where(there, cost, torch.inf).argmin())
        there[unit] = False
        row = inverse[:, unit] / inverse[:, unit, unit, None]
        layer = layer - layer[:, unit, None] * row
        inverse = inverse - inverse[:, :, unit, None] * row[:, None]
        layer[:, unit] = 0  # but for rounding it is
        inverse[:, unit, unit] = 1
        if left % STEP == 0:
            found.append(Narrower(there.nonzero().squeeze(1), *_split(layer.to(weight.dtype))))
    return found


def _split(layer: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return layer[:, :-1].contiguous(), layer[:, -1].contiguous()
