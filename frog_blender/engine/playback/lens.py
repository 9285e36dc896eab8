"""Depth of field: the cameras at points of a lens, whose images are averaged.

Each is exact for its point, with the occlusion that is seen from there. (Blurring splats one by one is faster, but a
surface of overlapping splats then lets light through: see docs/experiments/rasterizer.md.)
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Float64s
from ..capture.camera import Camera
from ..errors import FrogError

_GOLDEN = math.pi * (3 - math.sqrt(5))
_PLASTIC = 1.32471795724474602596  # its powers step through a square evenly (Roberts's R2 sequence)


@dataclass(frozen=True)
class Lens:
    """A thin lens, as Cycles has it.

    Attributes:
        radius: of the aperture, world units; 0 for a pinhole.
        focus: planar depth that is sharp, world units.
        blades: corners of the aperture; below 3 it is round.
        rotation: of the corners, radians.
        ratio: height by width of the aperture; above 1 blurs are narrow, as of an anamorphic lens.
    """

    radius: float
    focus: float
    blades: int = 0
    rotation: float = 0.0
    ratio: float = 1.0

    def __post_init__(self) -> None:
        """FrogError for numbers that are none of a lens."""
        numbers = (self.radius, self.focus, self.rotation, self.ratio)
        if not (np.isfinite(numbers).all() and self.radius >= 0 and self.focus > 0 and self.ratio > 0):
            raise FrogError(
                f"Found an aperture of radius {self.radius:g} and ratio {self.ratio:g} with the focus at "
                f"{self.focus:g}, expected a radius of at least 0, and a ratio and a focus above it."
            )

    def points(self, count: int) -> Float64s:
        """(count, 2) points of the aperture, x to the right and y up, world units; evenly spread, always the same."""
        steps = np.arange(count) + 0.5
        if self.blades < 3:
            distance, angle = np.sqrt(steps / count), np.arange(count) * _GOLDEN
            points = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
        else:
            points = _in_polygon(self.blades, self.rotation, steps / _PLASTIC % 1, steps / _PLASTIC**2 % 1)
        return np.asarray(points * [self.radius / self.ratio, self.radius])


def _in_polygon(corners: int, rotation: float, u: Float64s, v: Float64s) -> Float64s:
    """(N, 2) points of a regular polygon in the unit circle, from points (u, v) of the unit square."""
    corner = np.floor(u * corners)
    root = np.sqrt(u * corners - corner)
    v, u = v * root, 1 - root
    half = math.pi / corners
    x, y = (u + v) * math.cos(half), (u - v) * math.sin(half)
    turn = rotation + corner * 2 * half
    return np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], axis=1)


def seen_from(camera: Camera, point: Float64s, focus: float) -> Camera:
    """The camera moved to a point (2,) beside its centre, x to the right and y up, such that its image of the plane at
    depth ``focus`` stays where it is.
    """
    right, down = float(point[0]), -float(point[1])
    view, k = camera.world_to_camera.copy(), camera.intrinsics.copy()
    view[:2, 3] -= right, down
    k[0, 2] += k[0, 0] * right / focus
    k[1, 2] += k[1, 1] * down / focus
    return replace(camera, world_to_camera=view, intrinsics=k)
