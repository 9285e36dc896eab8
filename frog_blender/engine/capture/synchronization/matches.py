"""Which moving points of two films are the same point of the world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float32s, Float64s, Ints
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


@dataclass(frozen=True, eq=False)
class Search:
    """Which keyframes are compared, and which of their points may be the same.

    Attributes:
        lags: the least and the greatest lag to be considered, seconds.
        reach: seconds by which two keyframes may miss each other and still be compared.
        most: keyframes of the first film that are looked at, evenly spread.
        allowed: of rows of the first film's points (M,) and rows of the second's (K,): (M, K) bool; all without it.
    """

    lags: tuple[float, float]
    reach: float
    most: int = 1000
    allowed: Callable[[Ints, Ints], Bools] | None = None


def match(first: MovingPoints, second: MovingPoints, search: Search) -> Matches:
    """Mutual nearest neighbours between keyframes that may show the same instant."""
    count = len(first.key_times)
    chosen = np.unique(np.linspace(0, count - 1, min(search.most, count)).round().astype(int))
    rows_a, rows_b = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for key_a in chosen:
        in_a = first.of_keyframe(key_a)
        apart = first.key_times[key_a] - second.key_times
        near = (apart >= search.lags[0] - search.reach) & (apart <= search.lags[1] + search.reach)
        for key_b in np.flatnonzero(near):
            in_b = second.of_keyframe(int(key_b))
            if min(len(in_a), len(in_b)) < 2:
                continue
            similarity = first.descriptors[in_a] @ second.descriptors[in_b].T
            if search.allowed is not None:
                similarity[~search.allowed(in_a, in_b)] = -1.0
            a, b = _mutual(similarity)
            rows_a.append(in_a[a])
            rows_b.append(in_b[b])
    a, b = np.concatenate(rows_a), np.concatenate(rows_b)
    apart = first.key_times[first.keyframes[a]] - second.key_times[second.keyframes[b]]
    return Matches(a, b, apart)


def _mutual(similarity: Float32s) -> tuple[Ints, Ints]:
    """Rows and columns of the mutual best that are clearly better than the second best in their row."""
    best = similarity.argmax(axis=1)
    rows = np.arange(len(best))
    score = similarity[rows, best]
    second = np.partition(similarity, -2, axis=1)[:, -2]
    distance = np.sqrt(np.maximum(2 - 2 * score, 0))
    keep = distance < _RATIO * np.sqrt(np.maximum(2 - 2 * second, 0))
    keep &= (distance < _FARTHEST) & (similarity.argmax(axis=0)[best] == rows)
    return rows[keep].astype(np.int64), best[keep].astype(np.int64)
