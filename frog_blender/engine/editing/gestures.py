"""Selecting by hand in a view's image: where it shows Gaussians, and what a brush, a lasso or a box hits of them.

Each move of the mouse costs the same, however long the gesture has been, so that a viewport can show at once what is
hit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..gaussians import NumpyGaussians
from ..native.options import ALPHA_MIN, RasterizeOptions
from ..playback.render import draw
from ..playback.transform import rotations_of
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
        on_screen = cls(rows, np.clip(places, -_AWAY, _AWAY).astype(np.float32))
        if not only_visible or not len(rows):
            return on_screen
        visible = _visible(gaussians, camera, on_screen, z)
        return cls(rows[visible], np.ascontiguousarray(on_screen.places[:, visible]))

    def among(self, hit: Array, count: int) -> Array:
        """(count,) bool of all Gaussians, from (K,) bool of those that can be hit."""
        result = np.zeros(count, bool)
        result[self.rows[hit]] = True
        return result


def _visible(gaussians: NumpyGaussians, camera: Camera, on_screen: OnScreen, depths: Array) -> Array:
    """(K,) bool, of Gaussians at (K,) planar depths."""
    small = camera.scaled(min(1.0, _LONGEST_SIDE / max(camera.width, camera.height)))
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
    own = direction @ rotations_of(gaussians.quaternions[rows].astype(np.float64))  # in each one's own axes
    return np.asarray(np.linalg.norm(own * gaussians.scales[rows], axis=1))


BRUSH, LASSO, BOX = "BRUSH", "LASSO", "BOX"
Place = tuple[float, float]
"""x and y in pixels, as in ``OnScreen.places``."""


class Gesture:
    """What is drawn with the mouse over what a view shows.

    Args:
        radius: of the brush, in pixels.

    Attributes:
        path: the places so far.
        hit: (K,) bool, which of those that can be hit.
    """

    def __init__(self, screen: OnScreen, radius: float) -> None:
        self.places, self.radius = screen.places, radius
        self.path: list[Place] = []
        self.hit = self.open = np.zeros(len(screen.rows), bool)

    def move(self, position: Place) -> None:
        """Goes on to a place; the first one is where the gesture begins."""
        raise NotImplementedError


class _Brush(Gesture):
    """Hits what lies within a radius of the path of the mouse."""

    def move(self, position: Place) -> None:
        start, end = np.array(self.path[-1] if self.path else position), np.array(position)
        self.path.append(position)
        low, high = np.minimum(start, end) - self.radius, np.maximum(start, end) + self.radius
        (x, y), step = self.places, end - start
        near = np.flatnonzero((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))
        points = np.array([x[near], y[near]], np.float64)
        along = step @ (points - start[:, None]) / max(float(step @ step), 1e-12)
        offsets = points - start[:, None] - np.clip(along, 0, 1) * step[:, None]
        self.hit[near[np.einsum("ik,ik->k", offsets, offsets) <= self.radius**2]] = True


class _Lasso(Gesture):
    """Hits what lies in the outline that the mouse drew, closed by a straight line; where it overlaps itself, what an
    odd number of its loops encloses."""

    def move(self, position: Place) -> None:
        if self.path:
            self.open = self.open ^ _crosses(self.places, self.path[-1], position)
        self.path.append(position)
        self.hit = self.open ^ _crosses(self.places, position, self.path[0])


class _Box(Gesture):
    """Hits what lies between where the mouse was first and where it is."""

    def move(self, position: Place) -> None:
        self.path = [self.path[0] if self.path else position, position]
        (left, right), (top, bottom) = (sorted(pair) for pair in zip(*self.path, strict=True))
        x, y = self.places
        self.hit = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)


GESTURES: dict[str, type[Gesture]] = {BRUSH: _Brush, LASSO: _Lasso, BOX: _Box}


def drawn(kind: str, screen: OnScreen, path: Iterable[Place], radius: float) -> Gesture:
    """One of GESTURES that went along a path over what a view shows; ``radius`` of the brush, in pixels."""
    stroke = GESTURES[kind](screen, radius)
    for position in path:
        stroke.move(position)
    return stroke


def _crosses(places: Array, start: Place, end: Place) -> Array:
    """(K,) bool: whether the line from a place in the direction of x crosses an edge. The same in both directions of
    the edge, so that edges which are gone twice cancel out."""
    low, high = sorted((start, end), key=lambda position: (position[1], position[0]))
    result = np.zeros(places.shape[1], bool)
    near = np.flatnonzero((places[1] >= low[1]) & (places[1] < high[1]))
    x, y = places[:, near].astype(np.float64)
    result[near] = (high[0] - low[0]) * (y - low[1]) > (high[1] - low[1]) * (x - low[0])
    return result
