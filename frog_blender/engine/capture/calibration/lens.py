"""A lens as calibration estimates it: one focal length, the principal point in the middle, and at most k1 and k2.

More parameters are never supported by such data: eight-parameter models and free principal points were worse in every
case that was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Float64s
from ..camera import Camera
from ..readers.geometry import intrinsics

_INVERSIONS = 12


@dataclass(frozen=True)
class Lens:
    """One camera's size in pixels, focal length in pixels, and radial distortion as of OpenCV's k1 and k2."""

    width: int
    height: int
    focal: float
    k1: float = 0.0
    k2: float = 0.0

    @property
    def limit(self) -> float:
        """Pixels beyond which an observation is false: 4 are for photographs of 12 megapixels."""
        return max(1.0, 0.0025 * self.width)

    def camera(self, name: str, pose: Float64s) -> Camera:
        """The camera of a pose (3, 4), world to camera; without its distortion."""
        return Camera(
            name,
            self.width,
            self.height,
            intrinsics(self.focal, self.focal, self.width / 2, self.height / 2),
            np.vstack([pose, [[0.0, 0.0, 0.0, 1.0]]]),
        )

    def pixels(self, local: Float64s) -> Float64s:
        """(N, 2) pixels of points (N, 3) in the camera's axes, which lie before it."""
        plane = local[:, :2] / local[:, 2:]
        return self.focal * self._distorted(plane) + self._middle

    def rays(self, pixels: Float64s) -> Float64s:
        """(N, 2) positions in the plane at distance 1, of pixels (N, 2)."""
        distorted = (pixels - self._middle) / self.focal
        if not (self.k1 or self.k2):
            return distorted
        plane = distorted
        for _ in range(_INVERSIONS):
            plane = distorted / np.maximum(self._factor(plane), 0.1)
        return plane

    @property
    def _middle(self) -> Float64s:
        return np.array([self.width / 2, self.height / 2])

    def _factor(self, plane: Float64s) -> Float64s:
        square = np.sum(plane**2, axis=1, keepdims=True)
        factor: Float64s = 1 + self.k1 * square + self.k2 * square**2
        return factor

    def _distorted(self, plane: Float64s) -> Float64s:
        return plane * self._factor(plane) if self.k1 or self.k2 else plane
