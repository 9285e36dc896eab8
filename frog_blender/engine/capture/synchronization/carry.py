"""Moving points carried to common capture times, for a calibration that is to use what moves.

The background alone often leaves the middle of a volume empty. Points that move are there, once the films are in step:
calibrate, synchronise, calibrate with these points, synchronise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Float32s, Float64s
from .moving_points import MovingPoints
from .solve import Clock


@dataclass(frozen=True, eq=False)
class CarriedPoints:
    """What one camera shows of moving things at one capture time.

    Attributes:
        camera: its name.
        time: seconds of capture time.
        positions: (N, 2) float64 pixels of the film as stored, lens distortion included, pixel centres at +0.5.
        descriptors: (N, 128) float32 RootSIFT, unit length; to be matched between cameras at one time only.
    """

    camera: str
    time: float
    positions: Float64s
    descriptors: Float32s


def common_times(points: Mapping[str, MovingPoints], clocks: Mapping[str, Clock], most: int) -> Float64s:
    """(K,) seconds of capture time, K <= ``most``, near which at least two cameras have points: evenly spread.

    Args:
        points: by camera.
        clocks: by camera.
        most: times wanted.
    """
    spans = []
    for name, found in points.items():
        if len(found):
            clock = clocks[name]
            spans.append(clock.offset + clock.rate * found.key_times[[0, -1]])
    if len(spans) < 2:
        return np.zeros(0)
    starts, ends = np.sort([span[0] for span in spans]), np.sort([span[1] for span in spans])
    low, high = float(starts[1]), float(ends[-2])  # at least two cameras run
    return np.linspace(low, high, most) if high > low else np.array([low])


def carry(
    points: Mapping[str, MovingPoints], clocks: Mapping[str, Clock], times: Sequence[float] | Float64s
) -> list[CarriedPoints]:
    """Every camera's points at every capture time that its tracks reach; cameras without points there are left out.

    Args:
        points: by camera, in pixels of the films as stored.
        clocks: by camera.
        times: seconds of capture time.
    """
    carried = []
    for time in times:
        for name, found in points.items():
            if not len(found):
                continue
            clock = clocks[name]
            at = (float(time) - clock.offset) / clock.rate
            nearest = int(np.abs(found.key_times - at).argmin())
            rows = found.of_keyframe(nearest)
            positions, holds = found.positions(rows, np.full(len(rows), at))
            holds &= np.isfinite(positions).all(axis=1)
            if holds.any():
                kept = rows[holds]
                carried.append(CarriedPoints(name, float(time), positions[holds], found.descriptors[kept]))
    return carried
