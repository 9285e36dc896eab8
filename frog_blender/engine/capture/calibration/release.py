"""Which lens coefficients a model gets: k1, then k2, where tracks that the model was not adjusted to ask for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Float64s
from .adjustment import Adjusted, adjust
from .hypotheses import gains, halves, held_out_costs
from .mapping import Model
from .tracks import Tracks

KNOWN = -1
"""The kind of cameras whose coefficients are known already."""
_GAINS = 0.002  # of the held-out cost, before a coefficient is believed
_SURE = 0.02  # standard deviation of the focal length with it, over the focal length


@dataclass(frozen=True, eq=False)
class Released:
    """A model with the coefficients that held-out tracks ask for.

    Attributes:
        fits: the model adjusted to each half of the tracks.
        coefficients: for each camera how many of k1 and k2 are free.
        costs: (count,) of all tracks, each when it was held out.
    """

    fits: tuple[Adjusted, Adjusted]
    coefficients: list[int]
    costs: Float64s


def released(
    model: Model,
    tracks: Tracks,
    groups: Sequence[int],
    kinds: Sequence[int],
    coefficients: Sequence[int] | None = None,
) -> Released:
    """Frees k1, then k2, of all cameras of a kind together, where that lowers the cost of held-out tracks.

    Args:
        groups: cameras of one group share their lens.
        kinds: of each camera. Only observations of cameras whose kind is not ``KNOWN`` are counted.
        coefficients: how many each camera has to begin with; none by default.
    """
    one, other = halves(tracks)
    counted = np.array([kind != KNOWN for kind in kinds])

    def fitted(models: tuple[Model, Model], free: list[int]) -> Released:
        fits = adjust(models[0], one, groups, free), adjust(models[1], other, groups, free)
        costs = [held_out_costs(fits[0], other, counted), held_out_costs(fits[1], one, counted)]
        return Released(fits, free, np.concatenate(costs))

    best = fitted((model, model), list(coefficients or [0] * len(kinds)))
    for kind in sorted({kind for kind in kinds if kind != KNOWN}):
        for more in (1, 2):
            tried = [more if each == kind else had for each, had in zip(kinds, best.coefficients, strict=True)]
            new = fitted((best.fits[0].model, best.fits[1].model), tried)
            sure = max(_uncertainty(fit, kinds, kind) for fit in new.fits) < _SURE
            if not (sure and gains(best.costs, new.costs, _GAINS)):
                break
            best = new
    return best


def _uncertainty(adjusted: Adjusted, kinds: Sequence[int], kind: int) -> float:
    """Of the focal lengths of a kind's cameras that have a pose."""
    own = [camera for camera in adjusted.model.placed if kinds[camera] == kind]
    return float(np.max(adjusted.uncertainty[own], initial=0.0))
