"""Cameras from a few points that a person clicked in each camera's image: the last resort, and it is a good one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...arrays import Array
from .calibration import Calibration, CalibrationRefused
from .point_rig import PointViews, solve_points
from .rig_result import CameraFacts

MANY_ENOUGH = 16
"""Points that are asked for: as many as leave little open where each lies 2 pixels off."""
_LEAST = 8  # points of each camera, which other cameras have as well
_USUAL = 0.0015  # of the longer side: how far off a click is
_LIMIT = 0.008  # of the longer side: a click that is farther off is another point
_LEAST_SHARE = 0.75  # of a camera's clicks that must fit


def calibrate_clicks(facts: Sequence[CameraFacts], groups: Sequence[int], clicks: Mapping[str, Array]) -> Calibration:
    """The rig that a person's clicks fit, at an arbitrary scale.

    Args:
        facts: of the cameras.
        groups: cameras of one number share their focal length.
        clicks: for each camera's name (N, 2) pixels of the same N points, NaN where it does not see one; pixel
            centres at +0.5.

    Raises:
        CalibrationRefused: if a camera has too few points, or they leave the rig open.
        ValueError: for clicks of other shapes.
    """
    count = max((len(points) for points in clicks.values()), default=0)
    missing = np.full((count, 2), np.nan)
    pixels = np.stack([np.asarray(clicks.get(camera.name, missing), np.float64) for camera in facts])
    if pixels.shape != (len(facts), count, 2):
        raise ValueError(f"clicks of shape {pixels.shape}")
    sides = np.array([camera.side for camera in facts])
    views = PointViews(facts, np.array(groups), pixels, _LIMIT * sides)
    seen = views.seen
    useful = (seen & (seen.sum(0) >= 2)).sum(1)
    for camera, count in zip(facts, useful.tolist(), strict=True):
        if count < _LEAST:
            raise CalibrationRefused(
                f"Camera {camera.name} has {count} points that another camera has as well, expected {_LEAST} or more "
                f"({MANY_ENOUGH} are good): click corners that lie near and far, not all on one plane."
            )
    found = solve_points(views, float(_USUAL * sides.max()))
    for camera, share, count in zip(facts, found.shares.tolist(), useful.tolist(), strict=True):
        if share < _LEAST_SHARE:
            raise CalibrationRefused(
                f"{round((1 - share) * count)} of the {count} points of camera {camera.name} do not fit the others: "
                "look at whether each is the same point in every image."
            )
    warnings = []
    if useful.min() < MANY_ENOUGH:
        warnings.append(f"{useful.min()} points in a camera are few: with {MANY_ENOUGH} the rig is more certain.")
    return replace(found.calibration, warnings=tuple(warnings))
