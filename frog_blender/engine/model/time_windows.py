"""Gaussians that are seen around a time of their own before anything is learned.

What flies past, or appears, is at one place for a few frames. A Gaussian that begins there and is seen at all times is
wrong at most of them, and is gone before the network has learned when to show it. The temporal embedding can tell times
from the start: it is made of waves, so its products with itself at another time fall off with the distance in time. One
unit of the first layer is given these products, and opacities are given that unit.

The unit reads a few columns of the embeddings that nothing else reads, and no other: Gaussians that have no window have
zeros there, for which the unit is off, so that they are what they would be without it. These columns, and with them
place and width of each window, are learned; the unit stays as it is, but for how much it changes opacities.
"""

import math

import torch

from ..cuda import launch
from ..cuda.sources import kernel
from ..field.names import WINDOW_COLUMNS as COLUMNS
from .frog import Frog

_REACH = 20.0  # of the unit at a Gaussian's own time: embeddings have to be large beside one step of their optimiser
_THRESHOLD = 0.2  # of the reach, below which a time is another one
_OUTSIDE, _RISE = -3.0, 4.8  # opacity logits at other times, and what the own one adds
_UNIT = 0


def has_windows(model: Frog) -> bool:
    """Whether one of a model's units is the windows'."""
    return model.settings.modulation and bool((model.deformation.modulation_weight[:, -COLUMNS:] == 1).all(1).any())


@torch.no_grad()
def open_windows(model: Frog, times: torch.Tensor) -> None:
    """Gives Gaussians a time at which they are seen.

    Args:
        model: before its first step, of a recipe that has moments (``Recipe.moments_for``).
        times: (N,) in [0, 1], NaN for Gaussians that are seen at all times.
    """
    chosen = torch.isfinite(times).nonzero().squeeze(1)
    if not len(chosen):
        return
    canonical, field = model.canonical, model.deformation
    columns = slice(model.settings.embedding_size - COLUMNS, model.settings.embedding_size)
    model.temporal_table[:, columns] = _waves(model).to(model.temporal_table)
    moments, which = times[chosen].unique(return_inverse=True)
    waves = torch.cat([model.temporal_embedding(float(time))[:, columns] - 1 for time in moments])
    rows = torch.linspace(0, 1, model.settings.temporal_rows).tolist()
    mean = torch.cat([model.temporal_embedding(time)[:, columns] - 1 for time in rows]).mean(0)
    directions = waves - mean  # what all times have in common tells none from another
    own = (waves * directions).sum(1, keepdim=True)
    canonical.embeddings[:, columns] = 0
    canonical.embeddings[chosen, columns] = (_REACH / own * directions)[which]
    canonical.opacity_logits[chosen] = _OUTSIDE
    field.modulation_weight[_UNIT, columns] = 1
    field.output_weight[model.output_rows("opacity_logits"), _UNIT] = _RISE / (_REACH * (1 - _THRESHOLD))
    keep_apart(model)


@torch.no_grad()
def keep_apart(model: Frog) -> None:
    """Takes back what a step of the optimiser did to the unit of a model that ``has_windows``, and to what the other
    units read of the windows' columns."""
    field, opacity = model.deformation, model.output_rows("opacity_logits").start
    if launch.on_gpu(field.bias):
        weights = (
            field.modulation_weight,
            field.embedding_weight,
            field.temporal_weight,
            field.bias,
            field.output_weight,
        )
        sizes = *weights[0].shape, weights[2].shape[1], len(weights[4]), COLUMNS, opacity
        launcher = launch.launcher_for(field.bias.device)
        launcher.launch(kernel("windows"), len(field.bias), *sizes, -_THRESHOLD * _REACH, *weights)
        return
    # The others' weights there are steps away from zero, the unit's from one; hidden units may have been pruned.
    unit = (field.modulation_weight[:, -COLUMNS:].mean(1) > 0.5)[:, None]
    field.modulation_weight[:, :-COLUMNS].masked_fill_(unit, 0)
    field.modulation_weight[:, -COLUMNS:] = unit.to(field.modulation_weight)
    field.embedding_weight[:, -COLUMNS:] = 0
    field.embedding_weight.masked_fill_(unit, 0)
    field.temporal_weight.masked_fill_(unit, 0)
    field.bias.masked_fill_(unit[:, 0], -_THRESHOLD * _REACH)
    field.output_weight[:opacity].masked_fill_(unit.T, 0)
    field.output_weight[opacity + 1 :].masked_fill_(unit.T, 0)


def _waves(model: Frog) -> torch.Tensor:
    """(rows, COLUMNS) of the temporal table: as in ``frog.initial_table``, but of frequencies that are spread evenly
    whatever the seed, since few of them have to tell all times apart."""
    settings = model.settings
    times = torch.linspace(0, 1, settings.temporal_rows)[:, None]
    pairs = COLUMNS // 2
    turns = torch.arange(1, pairs + 1) / pairs * settings.coarse_rows / 4 * times
    return 1 + torch.sin(2 * math.pi * torch.stack([turns, turns + 0.25], dim=2).flatten(1))
