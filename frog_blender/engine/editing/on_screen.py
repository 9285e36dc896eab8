"""Where a view shows Gaussians: the centres of those that it draws, if wanted without what others hide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..gaussians import NumpyGaussians
from ..native.options import ALPHA_MIN, RasterizeOptions
from ..playback.render import draw
from .clusters import REACH

_LONGEST_SIDE = 480  # pixels of the image that says what lies before what
_AWAY = 1e30  # pixels: the largest place; float32 squares overflow beyond, which is no error


@dataclass(frozen=True, eq=False)
class OnScreen:
    """The centres of Gaussians in a view's image.

    Attributes:
        rows: (K,) ascending, the Gaussians that can be hit: what the view does not draw is not among them.
        places: (2, K) float32 their x and y in pixels from the image's upper left corner.
    """

    rows: Array
    places: Array

    @classmethod
    def of(cls, gaussians: NumpyGaussians, camera: Camera, *, only_visible: bool = False) -> OnScreen:
        """Of Gaussians as a camera sees them.

        Args:
            only_visible: leave out what lies outside of the image, or farther than what its pixel shows. That is the
                Gaussian that takes the light there through one half, as far as it reaches along the view.
        """
        local = camera.rotation @ gaussians.means.T.astype(np.float64) + camera.world_to_camera[:3, 3:]
        drawn = (local[2] >= RasterizeOptions().near_plane) & (gaussians.opacities > ALPHA_MIN)
        rows = np.flatnonzero(drawn)
        x, y, z = local[:, rows]
        k = camera.intrinsics
        places = np.array([k[0, 0] * x / z + k[0, 1] * y / z + k[0, 2], k[1, 1] * y / z + k[1, 2]])
        found = cls(rows, np.clip(places, -_AWAY, _AWAY).astype(np.float32))
        if not only_visible or not len(rows):
            return found
        visible = _visible(gaussians, camera, found, z)
        return cls(rows[visible], np.ascontiguousarray(found.places[:, visible]))

    def among(self, hit: Array, count: int) -> Array:
        """(count,) bool of all Gaussians, from (K,) bool of those that can be hit."""
        result = np.zeros(count, bool)
        result[self.rows[hit]] = True
        return result


def _visible(gaussians: NumpyGaussians, camera: Camera, on_screen: OnScreen, depths: Array) -> Array:
    """(K,) bool, of Gaussians at (K,) planar depths."""
    factor = min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))
    small = camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
    front = draw(gaussians, small).median_index
    size = np.array([[camera.width], [camera.height]])
    result: Array = ((on_screen.places >= 0) & (on_screen.places < size)).all(axis=0)
    column, row = (on_screen.places[:, result] * (np.array(front.shape[::-1])[:, None] / size)).astype(np.int64)
    nearest = front[np.minimum(row, front.shape[0] - 1), np.minimum(column, front.shape[1] - 1)]
    limit = camera.rotation[2] @ gaussians.means[nearest].T.astype(np.float64) + camera.world_to_camera[2, 3]
    limit += REACH * _extent(gaussians, nearest, camera.forward)
    result[result] = (nearest < 0) | (depths[result] <= limit)  # -1: nothing is there
    return result


def _extent(gaussians: NumpyGaussians, rows: Array, direction: Array) -> Array:
    """(K,) standard deviations of some Gaussians along a direction (3,), in world units."""
    quaternions = gaussians.quaternions[rows].astype(np.float64)
    quaternions /= np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
    back, real = -quaternions[:, 1:], quaternions[:, :1]  # the inverse turns the direction into each one's own axes
    twice = 2 * np.cross(back, direction)
    own = direction + real * twice + np.cross(back, twice)
    result: Array = np.linalg.norm(own * gaussians.scales[rows], axis=1)
    return result
