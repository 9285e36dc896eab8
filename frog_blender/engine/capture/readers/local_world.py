"""Coordinates near the cameras for captures whose own are those of a map, or so small or large that nothing fits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..capture import Capture
from ..world import World

_FAR = 300.0  # times the cameras' spread: beyond it, float32's steps come near to what images show
_FAR_ALONE = 1000.0  # units, of cameras that all stand in one place
_TINY, _HUGE = 1e-3, 1e6  # spreads in units


def localized(capture: Capture) -> Capture:
    """The capture with an offset and a scale taken off where single precision would not do, and a sentence of it; most
    captures stay as they are."""
    centers = np.array([camera.center for camera in capture.cameras])
    middle = np.median(centers, axis=0)
    spread = float(np.linalg.norm(centers - middle, axis=1).max())
    near = capture.near_far[0] if capture.near_far is not None else 0.0
    extent = max(spread, near)
    unit = 1.0
    if 0 < extent < _TINY or extent > _HUGE:
        unit = 10.0 ** math.floor(math.log10(extent))
    origin = (0.0, 0.0, 0.0)
    if np.linalg.norm(middle) > (_FAR * extent if extent > 0 else _FAR_ALONE):
        step = 10.0 ** math.floor(math.log10(extent)) if extent > 0 else 1.0
        x, y, z = (np.round(middle / step) * step).tolist()
        origin = (x, y, z)
    world = World(origin, unit)
    if world.is_plain:
        return capture
    near_far = capture.near_far and (capture.near_far[0] / unit, capture.near_far[1] / unit)
    said = f"{capture.path}: the cameras' coordinates need more than single precision; they are taken as {world}."
    return replace(
        capture,
        cameras=tuple(world.local_camera(camera) for camera in capture.cameras),
        near_far=near_far,
        points=None if capture.points is None else world.local_points(capture.points),
        world=world,
        warnings=(*capture.warnings, said),
    )
