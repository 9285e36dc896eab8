"""How far points are from a triangle mesh: a tree of boxes, gone through level by level for all points at once."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..scene.quantization import morton_order

_FIRST_LEVEL = 4  # of 16 boxes, with which every point begins
_POINTS_AT_ONCE, _MOST_PAIRS = 8192, 1 << 21  # of points and boxes
_SLACK = 1e-9  # of a distance: rounding takes no triangle away


class MeshDistance:
    """Distances from a mesh's surface.

    Args:
        vertices: (V, 3).
        triangles: (T, 3) into them, at least one.
    """

    def __init__(self, vertices: Array, triangles: Array) -> None:
        corners = np.asarray(vertices, np.float64)[triangles]
        corners = corners[morton_order(corners.mean(axis=1).astype(np.float32))]
        depth = max((len(corners) - 1).bit_length(), 0)
        # The last triangle stands for those that are missing in a whole tree.
        corners = np.concatenate([corners, np.repeat(corners[-1:], (1 << depth) - len(corners), axis=0)])
        self._corners = corners
        low, high, some = corners.min(axis=1), corners.max(axis=1), corners[:, 0]
        self._levels = [(low, high, some)]  # boxes, and of each a point of the surface that lies in it
        for _ in range(depth):
            low, high = np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2])
            some = some[::2]
            self._levels.append((low, high, some))
        self._levels.reverse()

    def within(self, points: Array, most: float) -> Array:
        """(N,) float64 distances of points (N, 3), or ``most`` where they are farther."""
        points = np.asarray(points, np.float64)
        result = np.full(len(points), float(most))
        low, high, _ = self._levels[0]
        near = np.flatnonzero(_squares(points, low, high) < most * most)
        for start in range(0, len(near), _POINTS_AT_ONCE):
            part = near[start : start + _POINTS_AT_ONCE]
            result[part] = np.sqrt(self._nearest(points[part], most * most))
        return result

    def _nearest(self, points: Array, most: float) -> Array:
        """(N,) squared distances, at most ``most``."""
        best = np.full(len(points), most)
        level = min(_FIRST_LEVEL, len(self._levels) - 1)
        boxes = len(self._levels[level][0])
        point, box = np.repeat(np.arange(len(points)), boxes), np.tile(np.arange(boxes), len(points))
        while True:
            low, high, some = self._levels[level]
            np.minimum.at(best, point, np.square(points[point] - some[box]).sum(axis=1))
            reached = _squares(points[point], low[box], high[box]) <= best[point] * (1 + _SLACK)
            point, box = point[reached], box[reached]
            if level == len(self._levels) - 1:
                break
            if 2 * len(point) > _MOST_PAIRS and len(points) > 1:  # points that are as far from everything
                half = len(points) // 2
                return np.concatenate([self._nearest(points[:half], most), self._nearest(points[half:], most)])
            level += 1
            point, box = np.repeat(point, 2), np.repeat(2 * box, 2) + np.tile([0, 1], len(box))
        np.minimum.at(best, point, _to_triangles(points[point], self._corners[box]))
        return best


def _squares(points: Array, low: Array, high: Array) -> Array:
    """(N,) squared distances of points from boxes; 0 inside."""
    result: Array = np.square(np.maximum(np.maximum(low - points, points - high), 0)).sum(axis=1)
    return result


def _to_triangles(points: Array, corners: Array) -> Array:
    """(P,) squared distances of points (P, 3) from their triangles (P, 3, 3), which may be flat."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    result = np.minimum(_to_segments(points, a, b), np.minimum(_to_segments(points, b, c), _to_segments(points, c, a)))
    normal = np.cross(b - a, c - a)
    size = np.square(normal).sum(axis=1)
    above = np.ones(len(points), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        above &= np.einsum("pi,pi->p", np.cross(end - start, points - start), normal) >= 0
    above &= size > 0
    height = np.einsum("pi,pi->p", points - a, normal)
    result[above] = np.minimum(result[above], np.square(height[above]) / size[above])
    return result


def _to_segments(points: Array, start: Array, end: Array) -> Array:
    along, offset = end - start, points - start
    length = np.square(along).sum(axis=1)
    share = np.einsum("pi,pi->p", offset, along) / np.where(length > 0, length, 1)
    result: Array = np.square(offset - np.clip(share, 0, 1)[:, None] * along).sum(axis=1)
    return result
