"""The one pass over a whole film: how much moves when, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import ImageArray
from .changing import SAMPLES, changing_region
from .energy import EnergyMeter, Signal
from .recordings import Recording
from .work import Kept, Work

_REPORTED = 50  # frames between reports


@dataclass(frozen=True, eq=False)
class Look:
    """What one pass over a film found.

    Attributes:
        energy: see EnergyMeter.signal.
        changing: (H, W) uint8, 255 where something moves, of the film's gray images.
    """

    energy: Signal
    changing: ImageArray


def look_at(film: Recording, work: Work, kept: Kept | None = None) -> Look:
    """Decode a film once, unless what came of it was kept; FrogError if it cannot be decoded."""
    if kept is not None and (arrays := kept.load("look_for_motion", film.key)) is not None:
        return Look((arrays["times"], arrays["energies"]), arrays["changing"])
    count = len(film.timestamps)
    sampled = {round(index) for index in np.linspace(0, count - 1, min(SAMPLES, count))}
    meter, samples = EnergyMeter(), []
    for index, gray in enumerate(film.gray(range(count))):
        if index % _REPORTED == 0:
            work.step(f"Looking for motion in {film.name}", index, count)
        meter.add(gray)
        if index in sampled:
            samples.append(gray)
    look = Look(meter.signal(film), changing_region(samples))
    if kept is not None:
        arrays = {"times": look.energy[0], "energies": look.energy[1], "changing": look.changing}
        kept.keep("look_for_motion", film.key, arrays)
    return look
