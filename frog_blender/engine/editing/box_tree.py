"""A tree of boxes around triangles or points: how far they are from other points."""

import numpy as np

from ..arrays import Array
from ..scene.quantization import morton_order

_PAIRS_AT_ONCE = 1 << 16  # of points and boxes
_SLACK = 1e-9  # of a distance: rounding takes no triangle away


class BoxTree:
    """Boxes of which each holds two of the next level; those of the last level hold one triangle or point each.

    Args:
        corners: (T, 3, 3) of triangles, or (T, 1, 3) points; at least one.
    """

    def __init__(self, corners: Array) -> None:
        corners = np.asarray(corners, np.float64)
        self._corners = corners[morton_order(corners.mean(axis=1).astype(np.float32))]
        low, high, some = self._corners.min(axis=1).T, self._corners.max(axis=1).T, self._corners[:, 0].T
        self._levels = [(low, high, some)]  # (3, boxes) each; last a corner that lies in the box
        while low.shape[1] > 1:
            first = np.arange(0, low.shape[1], 2)
            second = np.minimum(first + 1, low.shape[1] - 1)
            # Not by ``reduceat``, for which numpy keeps all other threads waiting.
            low, high = np.minimum(low[:, first], low[:, second]), np.maximum(high[:, first], high[:, second])
            some = some[:, ::2]
            self._levels.insert(0, (low, high, some))

    def within(self, points: Array, most: float, enough: float = 0.0) -> Array:
        """(N,) float64 distances of points (N, 3), or ``most`` where they are farther.

        Args:
            enough: where a distance is at most so large, it may be that of something else than the nearest.
        """
        columns = np.ascontiguousarray(points.T, np.float64)
        squares = np.full(len(points), float(most) ** 2)
        waiting = [(0, np.arange(len(points)), np.zeros(len(points), np.int64))]  # level, point and box of each pair
        while waiting:
            level, point, box = waiting.pop()
            low, high, some = self._levels[level]
            own = columns[:, point]
            np.minimum.at(squares, point, np.square(own - some[:, box]).sum(axis=0))
            outside = np.square(np.maximum(np.maximum(low[:, box] - own, own - high[:, box]), 0)).sum(axis=0)
            reached = (outside <= squares[point] * (1 + _SLACK)) & (squares[point] > enough**2)
            point, box = point[reached], box[reached]
            level += 1
            if level < len(self._levels):
                point, box = np.repeat(point, 2), np.repeat(2 * box, 2) + np.tile([0, 1], len(box))
                exists = box < self._levels[level][0].shape[1]
                parts = (np.array_split(part[exists], len(part) // _PAIRS_AT_ONCE + 1) for part in (point, box))
                waiting += [(level, *part) for part in zip(*parts, strict=True)]
            elif self._corners.shape[1] == 3:
                np.minimum.at(squares, point, _to_triangles(columns[:, point].T, self._corners[box]))
        return np.asarray(np.sqrt(squares))


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
    return np.asarray(np.square(offset - np.clip(share, 0, 1)[:, None] * along).sum(axis=1))
