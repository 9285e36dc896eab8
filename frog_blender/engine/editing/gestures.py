"""Selecting by hand in a view's image: a brush, a lasso or a box, one place of the mouse after the other.

Each move costs the same, however long the gesture has been, so that a viewport can show at once what is hit.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from ..arrays import Array
from .on_screen import OnScreen

BRUSH, LASSO, BOX = "BRUSH", "LASSO", "BOX"
GESTURES = (BRUSH, LASSO, BOX)
Place = tuple[float, float]
"""x and y in pixels, as in ``OnScreen.places``."""


class Gesture(Protocol):
    """What is drawn with the mouse.

    Attributes:
        path: the places so far.
        hit: (K,) bool, which of those that can be hit.
    """

    path: list[Place]
    hit: Array

    def move(self, place: Place) -> None:
        """Goes on to a place; the first one is where the gesture begins."""
        ...


def gesture(kind: str, screen: OnScreen, radius: float) -> Gesture:
    """A new one of GESTURES over what a view shows.

    Args:
        radius: of the brush, in pixels.
    """
    if kind == BRUSH:
        return _Brush(screen, radius)
    return _Lasso(screen) if kind == LASSO else _Box(screen)


def drawn(kind: str, screen: OnScreen, path: Iterable[Place], radius: float) -> Gesture:
    """One that went along a path."""
    found = gesture(kind, screen, radius)
    for place in path:
        found.move(place)
    return found


class _Brush:
    """Hits what lies within a radius of the way that the mouse went."""

    def __init__(self, screen: OnScreen, radius: float) -> None:
        self._x, self._y = screen.places
        self.radius = radius
        self.path: list[Place] = []
        self.hit = np.zeros(len(screen.rows), bool)

    def move(self, place: Place) -> None:
        start, end = np.array(self.path[-1] if self.path else place), np.array(place)
        self.path.append(place)
        low, high = np.minimum(start, end) - self.radius, np.maximum(start, end) + self.radius
        near = np.flatnonzero((self._x >= low[0]) & (self._x <= high[0]) & (self._y >= low[1]) & (self._y <= high[1]))
        points = np.array([self._x[near], self._y[near]], np.float64)
        way = end - start
        along = way @ (points - start[:, None]) / max(float(way @ way), 1e-12)
        offsets = points - start[:, None] - np.clip(along, 0, 1) * way[:, None]
        self.hit[near[np.einsum("ik,ik->k", offsets, offsets) <= self.radius**2]] = True


class _Lasso:
    """Hits what lies in the outline that the mouse drew, closed by a straight line; where it overlaps itself, what an
    odd number of its loops encloses."""

    def __init__(self, screen: OnScreen) -> None:
        self._places = screen.places
        self.path: list[Place] = []
        self._open = np.zeros(len(screen.rows), bool)
        self.hit = self._open

    def move(self, place: Place) -> None:
        if self.path:
            self._open = self._open ^ _crosses(self._places, self.path[-1], place)
        self.path.append(place)
        self.hit = self._open ^ _crosses(self._places, place, self.path[0])


class _Box:
    """Hits what lies between where the mouse was first and where it is."""

    def __init__(self, screen: OnScreen) -> None:
        self._x, self._y = screen.places
        self.path: list[Place] = []
        self.hit = np.zeros(len(screen.rows), bool)

    def move(self, place: Place) -> None:
        self.path = [self.path[0] if self.path else place, place]
        (left, right), (top, bottom) = (sorted(pair) for pair in zip(*self.path, strict=True))
        self.hit = (self._x >= left) & (self._x <= right) & (self._y >= top) & (self._y <= bottom)


def _crosses(places: Array, start: Place, end: Place) -> Array:
    """(K,) bool: whether the line from a place in the direction of x crosses an edge. The same in both directions of
    the edge, so that edges which are gone twice cancel out."""
    low, high = sorted((start, end), key=lambda place: (place[1], place[0]))
    result = np.zeros(places.shape[1], bool)
    near = np.flatnonzero((places[1] >= low[1]) & (places[1] < high[1]))
    x, y = places[:, near].astype(np.float64)
    result[near] = (high[0] - low[0]) * (y - low[1]) > (high[1] - low[1]) * (x - low[0])
    return result
