"""Points that move in one camera's film, tracked by optical flow, and which of two films' points are the same.

They are SIFT features inside the changing region. Each is tracked for a few frames to either side of the frame it was
found in, so that its position is known at every time between: films of other cameras show the same point at times
between these frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray, Ints
from ..video import load_opencv
from . import limits
from .films import Film
from .run import Run

REACH = 2
"""Frames to either side of its own in which a point is tracked."""
_NODES = 2 * REACH + 1


@dataclass(frozen=True, eq=False)
class MovingPoints:
    """N points of one film.

    Attributes:
        keyframes: (N,) int64, which of the film's keyframes each was found in: 0, 1, ... of ``key_times``.
        key_times: (K,) float64 seconds in the film, ascending.
        times: (N, 5) float64 seconds in the film: the frame it was found in and two to either side.
        tracks: (N, 5, 2) float64 pixels of the film (centres at +0.5); NaN where the flow lost it.
        descriptors: (N, 128) float32 RootSIFT, unit length.
    """

    keyframes: Ints
    key_times: Float64s
    times: Float64s
    tracks: Float64s
    descriptors: Float32s

    def __len__(self) -> int:
        return len(self.keyframes)

    def of_keyframe(self, keyframe: int) -> Ints:
        """The points found in one keyframe: their rows (M,)."""
        first, last = np.searchsorted(self.keyframes, [keyframe, keyframe + 1])
        return np.arange(first, last)

    def positions(self, which: Array, at: Float64s) -> tuple[Float64s, Bools]:
        """Positions (M, 2) in pixels of the points ``which`` (M,) at film times ``at`` (M,) seconds, and which hold.

        A parabola through the three tracked positions nearest in time; it holds up to half a frame beyond a track.
        """
        times, tracks = self.times[which], self.tracks[which]
        tracked = np.isfinite(tracks[..., 0])
        middle = np.abs(times - at[:, None]).argmin(axis=1).clip(1, _NODES - 2)
        rows = np.arange(len(middle))
        whole = tracked[rows, middle - 1] & tracked[rows, middle] & tracked[rows, middle + 1]
        middle = np.where(whole, middle, REACH)
        three = middle[:, None] + np.arange(-1, 2)
        t = times[rows[:, None], three]
        p = tracks[rows[:, None], three]
        frame = (t[:, 2] - t[:, 0]) / 2
        holds = (at >= t[:, 0] - limits.BEYOND * frame) & (at <= t[:, 2] + limits.BEYOND * frame)
        return _lagrange(t, p, at), holds


def _lagrange(times: Float64s, points: Float64s, at: Float64s) -> Float64s:
    """(M, 2) on parabolas through points (M, 3, 2) at times (M, 3), evaluated at (M,)."""
    gaps = at[:, None] - times
    t0, t1, t2 = times.T
    weights = np.stack(
        [
            gaps[:, 1] * gaps[:, 2] / ((t0 - t1) * (t0 - t2)),
            gaps[:, 0] * gaps[:, 2] / ((t1 - t0) * (t1 - t2)),
            gaps[:, 0] * gaps[:, 1] / ((t2 - t0) * (t2 - t1)),
        ],
        axis=1,
    )
    result: Float64s = (weights[..., None] * points).sum(axis=1)
    return result


def keyframes_of(indices: Iterable[int], frame_count: int) -> list[int]:
    """Those of the frames that have REACH frames to either side."""
    return sorted({index for index in indices if REACH <= index < frame_count - REACH})


def points_in(film: Film, region: ImageArray, keyframes: Sequence[int], run: Run) -> MovingPoints:
    """The moving points of a film.

    Args:
        region: (H, W) uint8 of its gray images, where something moves.
        keyframes: of ``keyframes_of``.
    """
    needed = sorted({key + shift for key in keyframes for shift in range(-REACH, REACH + 1)})
    recent: dict[int, ImageArray] = {}
    parts = [(np.zeros(0, np.int64), np.zeros((0, _NODES, 2)), np.zeros((0, 128), np.float32))]
    for index, gray in zip(needed, film.gray(needed, limits.LONGEST_SIDE), strict=True):
        run.check()
        recent[index] = gray
        key = index - REACH
        if key in keyframes and region.any():
            tracks, descriptors = _tracked([recent[key + shift] for shift in range(-REACH, REACH + 1)], region)
            parts.append((np.full(len(tracks), keyframes.index(key)), tracks, descriptors))
        recent.pop(index - 2 * REACH, None)
    rows, tracks, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
    frames = np.array(keyframes, np.int64)
    times = film.stamps[frames[rows][:, None] + np.arange(-REACH, REACH + 1)]
    return MovingPoints(rows, film.stamps[frames], times, tracks / film.scale(limits.LONGEST_SIDE), descriptors)


def _tracked(images: Sequence[ImageArray], region: ImageArray) -> tuple[Float64s, Float32s]:
    """Tracks (M, 5, 2) in pixels of the gray images, centres at +0.5, and descriptors (M, 128), of five images."""
    cv2 = load_opencv()
    options = {"contrastThreshold": limits.CONTRAST, "enable_precise_upscale": True}
    rows, columns = _bounds(region)
    sift = cv2.SIFT_create(nfeatures=limits.MOST_FEATURES, **options)
    features, descriptors = sift.detectAndCompute(images[REACH][rows, columns], region[rows, columns])
    if descriptors is None or not len(features):
        return np.zeros((0, _NODES, 2)), np.zeros((0, 128), np.float32)
    corner = (columns.start, rows.start)
    start = (np.array([feature.pt for feature in features]) + corner).astype(np.float32)
    after, good = _flow(images[REACH], images[REACH + 1], start)
    moving = np.flatnonzero(good & (np.linalg.norm(after - start, axis=1) > limits.STILL))
    strength = np.array([features[point].response for point in moving])
    chosen = np.sort(moving[np.argsort(-strength, kind="stable")[: limits.MOST_MOVING]])
    if not len(chosen):
        return np.zeros((0, _NODES, 2)), np.zeros((0, 128), np.float32)
    tracks = np.full((len(chosen), _NODES, 2), np.nan)
    tracks[:, REACH] = start[chosen]
    for direction in (-1, 1):
        position, alive = start[chosen], np.ones(len(chosen), dtype=bool)
        for step in range(1, REACH + 1):
            before = images[REACH + direction * (step - 1)]
            position, good = _flow(before, images[REACH + direction * step], position)
            alive &= good
            tracks[alive, REACH + direction * step] = position[alive]
    whole = np.isfinite(tracks[:, REACH - 1 : REACH + 2, 0]).all(axis=1)
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    return tracks[whole] + 0.5, roots[chosen[whole]].astype(np.float32)


def _bounds(mask: ImageArray) -> tuple[slice, slice]:
    """Rows and columns of a mask (H, W) that hold all of it and a margin: outside, features cost time for nothing."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    top, left = max(int(rows[0]) - limits.FEATURE_MARGIN, 0), max(int(columns[0]) - limits.FEATURE_MARGIN, 0)
    return slice(top, int(rows[-1]) + limits.FEATURE_MARGIN + 1), slice(
        left, int(columns[-1]) + limits.FEATURE_MARGIN + 1
    )


def _flow(before: ImageArray, after: ImageArray, points: Float32s) -> tuple[Float32s, Bools]:
    """Where points (N, 2) went, and which of them came back to where they started."""
    cv2 = load_opencv()
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    options = {"winSize": limits.FLOW_WINDOW, "maxLevel": 3, "criteria": criteria}
    there, gone, _ = cv2.calcOpticalFlowPyrLK(before, after, points[:, None], None, **options)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(after, before, there, None, **options)
    missed = np.linalg.norm(back[:, 0] - points, axis=1)
    good = (gone[:, 0] > 0) & (returned[:, 0] > 0) & (missed < limits.FLOW_BACK)
    return there[:, 0], good


# --- matches


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
            a, b = mutual(similarity, limits.MATCH_RATIO, limits.MATCH_FARTHEST)
            rows_a.append(in_a[a])
            rows_b.append(in_b[b])
    a, b = np.concatenate(rows_a), np.concatenate(rows_b)
    apart = first.key_times[first.keyframes[a]] - second.key_times[second.keyframes[b]]
    return Matches(a, b, apart)


def mutual(similarity: Float32s, ratio: float, farthest: float = np.inf) -> tuple[Ints, Ints]:
    """Rows and columns of the mutual best of unit descriptors' products (N, K) that are clearly better than the second
    best in their row, by Lowe's ratio test (2004).

    Args:
        ratio: of their distances, at most.
        farthest: distance of the best.
    """
    best, columns = similarity.argmax(axis=1), similarity.argmax(axis=0)
    rows = np.arange(len(best))
    score = similarity[rows, best]
    similarity[rows, best] = -2.0
    distance, second = (np.sqrt(np.maximum(2 - 2 * values, 0)) for values in (score, similarity.max(axis=1)))
    keep = (distance < ratio * second) & (distance < farthest) & (columns[best] == rows)
    return rows[keep].astype(np.int64), best[keep].astype(np.int64)
