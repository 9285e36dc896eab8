"""Which moving points of two films are the same point of the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Float64s, Ints
from .moving_points import MovingPoints

_RATIO = 0.8  # best to second best descriptor distance
_FARTHEST = 0.75  # between unit descriptors


@dataclass(frozen=True, eq=False)
class Matches:
    """M matches between points of two films.

    Attributes:
        first, second: (M,) int64 rows in the films' MovingPoints.
        apart: (M,) float64 seconds: the time of the point in the first film less that in the second.
    """

    first: Ints
    second: Ints
    apart: Float64s

    def __len__(self) -> int:
        return len(self.first)

    def thinned(self, most: int) -> Matches:
        """At most so many of them, drawn evenly."""
        if len(self) <= most:
            return self
        kept = np.linspace(0, len(self) - 1, most).round().astype(np.int64)
        return Matches(self.first[kept], self.second[kept], self.apart[kept])

    def within(self, lag: Float64s | float, reach: float) -> Matches:
        """Those whose two times, ``lag`` seconds apart in the films, lie within ``reach`` seconds of each other."""
        keep = np.abs(self.apart - lag) <= reach
        return Matches(self.first[keep], self.second[keep], self.apart[keep])


def match(
    first: MovingPoints, second: MovingPoints, lags: tuple[float, float], reach: float, most: int = 1000
) -> Matches:
    """Mutual nearest neighbours between keyframes that may show the same instant.

    Args:
        first, second: the points of two films.
        lags: the least and the greatest lag to be considered, seconds.
        reach: seconds by which two keyframes may miss each other and still be compared.
        most: keyframes of the first film that are looked at, evenly spread.
    """
    chosen = np.unique(np.linspace(0, len(first.key_times) - 1, min(most, len(first.key_times))).round().astype(int))
    rows_a, rows_b = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for key_a in chosen:
        time_a = first.key_times[key_a]
        slice_a = first.of_keyframe(key_a)
        if slice_a.stop - slice_a.start < 2:
            continue
        for key_b, time_b in enumerate(second.key_times):
            slice_b = second.of_keyframe(key_b)
            far = not lags[0] - reach <= time_a - time_b <= lags[1] + reach
            if far or slice_b.stop - slice_b.start < 2:
                continue
            in_a, in_b = _mutual(first.descriptors[slice_a] @ second.descriptors[slice_b].T)
            rows_a.append(in_a + slice_a.start)
            rows_b.append(in_b + slice_b.start)
    a, b = np.concatenate(rows_a), np.concatenate(rows_b)
    apart = first.key_times[first.keyframes[a]] - second.key_times[second.keyframes[b]]
    return Matches(a, b, apart)


def _mutual(similarity: np.ndarray) -> tuple[Ints, Ints]:
    """Rows and columns of the mutual best that are clearly better than the second best in their row."""
    best = similarity.argmax(axis=1)
    rows = np.arange(len(best))
    score = similarity[rows, best]
    second = np.partition(similarity, -2, axis=1)[:, -2]
    distance = np.sqrt(np.maximum(2 - 2 * score, 0))
    keep = distance < _RATIO * np.sqrt(np.maximum(2 - 2 * second, 0))
    keep &= (distance < _FARTHEST) & (similarity.argmax(axis=0)[best] == rows)
    return rows[keep].astype(np.int64), best[keep].astype(np.int64)
