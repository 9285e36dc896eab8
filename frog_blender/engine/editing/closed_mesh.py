"""Closed triangle meshes: which points lie inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Array

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
        """Of arrays (V, 3) and (T, 3), or as flat."""
        return cls(np.ascontiguousarray(vertices, "<f4").tobytes(), np.ascontiguousarray(triangles, "<i4").tobytes())

    @cached_property
    def arrays(self) -> tuple[Array, Array]:
        """(V, 3) float64 vertices and (T, 3) int32 triangles."""
        vertices = np.frombuffer(self.vertices, "<f4").reshape(-1, 3).astype(np.float64)
        return vertices, np.frombuffer(self.triangles, "<i4").reshape(-1, 3)

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
    return np.asarray(np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - lengths, lengths))


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
    return np.asarray(spans & (side > 0))
