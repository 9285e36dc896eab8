"""Cameras from the parameters that calibrations state, in the project's convention (see ``camera``)."""

from __future__ import annotations

import numpy as np

from ...arrays import Float64s
from ..capture import Distortion

_PROPORTIONS = 0.02  # relative difference of two aspect ratios that rounded sizes explain
_TRANSPOSED = 0.01


def intrinsics(focal_x: float, focal_y: float, center_x: float, center_y: float) -> Float64s:
    """(3, 3) matrix K of focal lengths and a principal point in pixels."""
    return np.array([[focal_x, 0.0, center_x], [0.0, focal_y, center_y], [0.0, 0.0, 1.0]])


def pose(world_to_camera_rotation: Float64s, center: Float64s) -> Float64s:
    """(4, 4) world-to-camera matrix of a rotation (3, 3) and a camera centre (3,) in world units."""
    matrix = np.eye(4)
    matrix[:3, :3] = world_to_camera_rotation
    matrix[:3, 3] = -world_to_camera_rotation @ center
    return matrix


def distortion(coefficients: Float64s, skew: float = 0.0) -> Distortion | None:
    """See ``Distortion``; None where the lens needs no correction."""
    return Distortion(coefficients, skew) if skew or np.any(coefficients) else None


def is_transposed(size: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether one of two sizes (width, height) has the proportions of the other turned by 90 degrees, not its own."""
    upright, lying = size[0] * other[1] / (size[1] * other[0]), size[0] * other[0] / (size[1] * other[1])
    return abs(lying - 1) < _TRANSPOSED < abs(upright - 1)


def same_proportions(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes (width, height) have the same aspect ratio, to 2 %."""
    return abs(size[0] * other[1] / (size[1] * other[0]) - 1) <= _PROPORTIONS
