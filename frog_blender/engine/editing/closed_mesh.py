"""Closed triangle meshes: which points lie inside, and how far from the surface others are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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


MOST_VERTICES, MOST_TRIANGLES = 100_000, 200_000
_CELLS = 128  # of a side of the grid that points are sorted into
_PAIRS_AT_ONCE = 1 << 20  # of points and triangles


@dataclass(frozen=True)
class ClosedMesh:
    """A mesh without borders: every edge belongs to an even number of triangles.

    Attributes:
        vertices: (V, 3) little-endian float32.
        triangles: (T, 3) little-endian int32 into them.

    Raises:
        ValueError: for a mesh that is too large, damaged or open.
    """

    vertices: bytes
    triangles: bytes

    def __post_init__(self) -> None:
        if len(self.vertices) % 12 or len(self.triangles) % 12:
            raise ValueError("a mesh of incomplete vertices or triangles")
        if not 4 <= len(self.vertices) // 12 <= MOST_VERTICES or not 4 <= len(self.triangles) // 12 <= MOST_TRIANGLES:
            size = f"{len(self.vertices) // 12:,} vertices and {len(self.triangles) // 12:,} triangles"
            raise ValueError(f"a mesh of {size}; from 4 to {MOST_VERTICES:,} and {MOST_TRIANGLES:,} are possible")
        points, corners = self.arrays
        if not np.isfinite(points).all():
            raise ValueError("a mesh with vertices that are not finite")
        if corners.min() < 0 or corners.max() >= len(points):
            raise ValueError("a mesh whose triangles have vertices that are not there")
        edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
        _, uses = np.unique(edges[:, 0] * len(points) + edges[:, 1], return_counts=True)
        if (uses % 2).any():
            raise ValueError("a mesh with open borders")

    @classmethod
    def of(cls, vertices: Array, triangles: Array) -> ClosedMesh:
        """Of arrays (V, 3) and (T, 3)."""
        return cls(np.ascontiguousarray(vertices, "<f4").tobytes(), np.ascontiguousarray(triangles, "<i4").tobytes())

    @cached_property
    def arrays(self) -> tuple[Array, Array]:
        """(V, 3) float64 vertices and (T, 3) int32 triangles."""
        return (
            np.frombuffer(self.vertices, "<f4").reshape(-1, 3).astype(np.float64),
            np.frombuffer(self.triangles, "<i4").reshape(-1, 3),
        )

    def contains(self, points: Array) -> Array:
        """(N,) bool for points (N, 3) in the mesh's own space: an odd number of its triangles lies above them.

        A ray through an edge or a vertex counts right: whether a point is left of an edge is the same number for both
        triangles that share it.
        """
        corners = self.arrays[0][self.arrays[1]]  # (T, 3, 3)
        inside = np.zeros(len(points), bool)
        low, high = corners.min((0, 1)), corners.max((0, 1))
        near = np.flatnonzero(((points >= low) & (points <= high)).all(1))
        if not len(near) or not (high > low).all():
            return inside
        candidates = points[near].astype(np.float64)
        per_cell = _CELLS / (high[:2] - low[:2])
        cell = np.clip(((candidates[:, :2] - low[:2]) * per_cell).astype(np.int64), 0, _CELLS - 1)
        row = cell[:, 1] * _CELLS + cell[:, 0]
        order = np.argsort(row, kind="stable")
        row = row[order]
        first = np.clip(((corners.min(1)[:, :2] - low[:2]) * per_cell).astype(np.int64), 0, _CELLS - 1)
        last = np.clip(((corners.max(1)[:, :2] - low[:2]) * per_cell).astype(np.int64), 0, _CELLS - 1)
        # Of each triangle the rows of cells it lies over, of each of these the run of sorted points in it.
        heights = last[:, 1] - first[:, 1] + 1
        triangle = np.repeat(np.arange(len(corners)), heights)
        line = first[triangle, 1] + _counted(heights)
        begin = np.searchsorted(row, line * _CELLS + first[triangle, 0], "left")
        end = np.searchsorted(row, line * _CELLS + last[triangle, 0], "right")
        crossings = np.zeros(len(candidates), np.int64)
        lengths = end - begin
        bounds = np.searchsorted(np.cumsum(lengths), np.arange(0, lengths.sum() + 1, _PAIRS_AT_ONCE)[1:], "left") + 1
        for part in np.split(np.arange(len(lengths)), bounds):
            pairs = np.repeat(part, lengths[part])
            if len(pairs):
                point = order[begin[pairs] + _counted(lengths[part])]
                above = _lies_above(candidates[point], corners[triangle[pairs]])
                crossings += np.bincount(point[above], minlength=len(candidates))
        inside[near] = crossings % 2 == 1
        return inside


def _counted(lengths: Array) -> Array:
    """0, 1, ... of each length, one after the other."""
    ends = np.cumsum(lengths)
    result: Array = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - lengths, lengths)
    return result


def _lies_above(points: Array, corners: Array) -> Array:
    """(P,) bool: whether the vertical line through (P, 3) points meets their triangle (P, 3, 3) above the point."""
    inside = np.zeros(len(points), bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        inside ^= _passes(points, corners[:, a], corners[:, b])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offset = np.einsum("pi,pi->p", normal, corners[:, 0] - points)  # along z: offset / normal z
    return inside & (np.where(normal[:, 2] < 0, -offset, offset) > 0)


def _passes(points: Array, start: Array, end: Array) -> Array:
    """(P,) bool: whether the line from a point in the direction of x crosses an edge, seen from above."""
    swap = (start[:, 1] > end[:, 1]) | ((start[:, 1] == end[:, 1]) & (start[:, 0] > end[:, 0]))
    low, high = np.where(swap[:, None], end, start), np.where(swap[:, None], start, end)
    spans = (low[:, 1] <= points[:, 1]) & (points[:, 1] < high[:, 1])
    side = (high[:, 0] - low[:, 0]) * (points[:, 1] - low[:, 1]) - (points[:, 0] - low[:, 0]) * (high[:, 1] - low[:, 1])
    result: Array = spans & (side > 0)
    return result
