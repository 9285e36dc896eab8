"""A tree of boxes around points: how far they are from other points."""

import numpy as np

from ..arrays import Array
from ..scene.quantization import morton_order

_PAIRS_AT_ONCE = 1 << 16  # of points and boxes
_SLACK = 1e-9  # of a distance: rounding takes no point away


class BoxTree:
    """Boxes of which each holds two of the next level; those of the last level hold one point each.

    Args:
        places: (T, 3) points; at least one.
    """

    def __init__(self, places: Array) -> None:
        low = high = some = np.asarray(places, np.float64)[morton_order(places.astype(np.float32))].T
        self._levels = [(low, high, some)]  # (3, boxes) each; last a point that lies in the box
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
        return np.asarray(np.sqrt(squares))
