"""Where the cameras of a rig stand: directions around a box, and the distance at which a lens holds all of it.

World: z up, the front is -y, as Blender's front view looks. Without bpy.
"""

import math

import numpy as np

from ..engine.arrays import Float64s

_RINGS = ((10.0,), (8.0, 38.0), (5.0, 30.0, 58.0))
"""Elevations in degrees of one, two and three rings."""
_EACH = 8  # cameras of a ring before there is another one
_ARC_ROWS = (5.0, 20.0)  # elevations in degrees between which an arc's cameras alternate: depth needs both directions
_DOME = (5.0, 80.0)  # lowest and highest elevation in degrees
_GOLDEN = math.pi * (3 - math.sqrt(5))  # the angle that spreads points on a sphere evenly
_MARGIN = 1.06  # of the image, beside the box


def directions(shape: str, count: int, arc: float) -> Float64s:
    """(count, 3) unit vectors from the box's middle to the cameras, of which there is at least one.

    Args:
        shape: RINGS, DOME or ARC.
        arc: radians that an arc spans.
    """
    if shape == "RINGS":
        azimuths, elevations = _rings(count)
    elif shape == "DOME":
        low, high = (math.sin(math.radians(angle)) for angle in _DOME)
        heights = low + (high - low) * (np.arange(count) + 0.5) / count
        azimuths, elevations = np.arange(count) * _GOLDEN, np.arcsin(heights)
    else:
        azimuths = (np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1)) * arc
        elevations = np.radians([_ARC_ROWS[index % 2] for index in range(count)])
    flat = np.cos(elevations)
    return np.stack([np.sin(azimuths) * flat, -np.cos(azimuths) * flat, np.sin(elevations)], axis=1)


def _rings(count: int) -> tuple[Float64s, Float64s]:
    rows = _RINGS[min(count // _EACH, len(_RINGS)) - 1] if count >= _EACH else _RINGS[0]
    azimuths, elevations = [], []
    for row, elevation in enumerate(rows):
        here = count // len(rows) + (row < count % len(rows))
        turns = (np.arange(here) + row / len(rows)) / here  # rows stand in each other's gaps
        azimuths.append(2 * math.pi * turns)
        elevations.append(np.full(here, math.radians(elevation)))
    return np.concatenate(azimuths), np.concatenate(elevations)


def distance(corners: Float64s, outward: Float64s, tangent: float) -> float:
    """How far from the middle cameras must stand to see all of a box.

    Args:
        corners: (8, 3) of the box, from the middle.
        outward: (N, 3) unit vectors from the middle to the cameras.
        tangent: of half the narrower angle of view.
    """
    away = 0.0
    for direction in outward:
        axes = pose(direction, np.zeros(3), 0.0)[:3, :3]
        local = corners @ axes
        away = max(away, float((np.abs(local[:, :2]).max(axis=1) * _MARGIN / tangent + local[:, 2]).max()))
    return away


def pose(direction: Float64s, middle: Float64s, away: float) -> Float64s:
    """(4, 4) matrix of a Blender camera that looks at a point, upright.

    Args:
        direction: (3,) unit vector from the point to the camera.
        middle: (3,) the point.
        away: distance from it.
    """
    upwards = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 1 - 1e-9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(upwards, direction)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(direction, right), direction, middle + away * direction], axis=1)
    return matrix
