"""Gaussians that are seen around a time of their own before anything is learned.

What flies past, or appears, is at one place for a few frames. A Gaussian that begins there and is seen at all times is
wrong at most of them, and is gone before the network has learned when to show it. The temporal embedding can tell times
from the start: it is made of waves, so its products with itself at another time fall off with the distance in time. One
unit of the first layer is given these products, and opacities are given that unit.
"""

from __future__ import annotations

import torch

from .frog import Frog

_REACH = 20.0  # of the unit at a Gaussian's own time: embeddings have to be large beside one step of their optimiser
_THRESHOLD = 0.2  # of the reach, below which a time is another one
_OUTSIDE, _RISE = -3.0, 4.8  # opacity logits at other times, and what the own one adds
_UNIT = 0


def can_open(model: Frog) -> bool:
    """Whether a model has what windows are made of."""
    settings = model.settings
    return settings.modulation and settings.deformed_opacity and model.deformation.can_narrow


@torch.no_grad()
def open_windows(model: Frog, times: torch.Tensor) -> None:
    """Gives Gaussians a time at which they are seen.

    Args:
        model: before its first step, one that ``can_open``.
        times: (N,) in [0, 1], NaN for Gaussians that are seen at all times.
    """
    chosen = torch.isfinite(times).nonzero().squeeze(1)
    if not len(chosen):
        return
    canonical, field, size = model.canonical, model.deformation, model.settings.embedding_size
    moments, which = times[chosen].unique(return_inverse=True)
    waves = torch.cat([model.temporal_embedding(float(time))[:, :size] - 1 for time in moments])
    rows = torch.linspace(0, 1, model.settings.temporal_rows).tolist()
    mean = torch.cat([model.temporal_embedding(time)[:, :size] - 1 for time in rows]).mean(0)
    directions = waves - mean  # what all times have in common tells none from another
    own = (waves * directions).sum(1, keepdim=True)
    canonical.embeddings[chosen] = (_REACH / own * directions)[which]
    canonical.opacity_logits[chosen] = _OUTSIDE
    field.embedding_weight[_UNIT] = 0
    field.temporal_weight[_UNIT] = 0
    field.bias[_UNIT] = -_THRESHOLD * _REACH
    field.modulation_weight[_UNIT] = 1
    field.output_weight[model.output_rows("opacity_logits"), _UNIT] = _RISE / (_REACH * (1 - _THRESHOLD))
