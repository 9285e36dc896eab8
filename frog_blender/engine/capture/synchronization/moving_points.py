"""Points that move in one camera's film, tracked by optical flow, and which of two films' points are the same.

They are SIFT features inside the changing region. Each is tracked for a few frames to either side of the frame it was
found in, so that its position is known at every time between: films of other cameras show the same point at times
between these frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray, Ints
from ..epipolar import mutual
from ..video import load_opencv
from . import limits
from .films import Film, spread

REACH = 2
"""Frames to either side of its own in which a point is tracked."""
_NODES = 2 * REACH + 1
_SHIFTS = range(-REACH, REACH + 1)


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
        gaps, result = at[:, None] - t, np.zeros((len(middle), 2))
        for i, j, k in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):  # Lagrange's polynomials
            weight = gaps[:, j] * gaps[:, k] / ((t[:, i] - t[:, j]) * (t[:, i] - t[:, k]))
            result += weight[:, None] * p[:, i]
        return result, holds


def points_in(film: Film, region: ImageArray, keyframes: Sequence[int]) -> MovingPoints:
    """The moving points of a film.

    Args:
        region: (H, W) uint8 of its gray images, where something moves.
        keyframes: ascending, with REACH frames to either side.
    """
    needed = sorted({key + shift for key in keyframes for shift in _SHIFTS})
    recent: dict[int, ImageArray] = {}
    parts = [(np.zeros(0, np.int64), np.zeros((0, _NODES, 2)), np.zeros((0, 128), np.float32))]
    for index, gray in zip(needed, film.gray(needed, limits.LONGEST_SIDE), strict=True):
        recent[index] = gray
        key = index - REACH
        if key in keyframes and region.any():
            moving = _tracked([recent[key + shift] for shift in _SHIFTS], region)
            if moving is not None:
                parts.append((np.full(len(moving[0]), keyframes.index(key)), *moving))
        recent.pop(index - 2 * REACH, None)
    rows, tracks, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
    frames = np.array(keyframes, np.int64)
    times = film.stamps[frames[rows][:, None] + np.array(_SHIFTS)]
    scale = min(1.0, limits.LONGEST_SIDE / max(film.size))
    return MovingPoints(rows, film.stamps[frames], times, tracks / scale, descriptors)


def _tracked(images: Sequence[ImageArray], region: ImageArray) -> tuple[Float64s, Float32s] | None:
    """Tracks (M, 5, 2) in pixels of the gray images, centres at +0.5, and descriptors (M, 128), of five images; None
    where no feature moves."""
    cv2 = load_opencv()
    options = {"contrastThreshold": limits.CONTRAST, "enable_precise_upscale": True}
    rows, columns = (_span(region.any(axis=axis)) for axis in (1, 0))
    sift = cv2.SIFT_create(nfeatures=limits.MOST_FEATURES, **options)
    features, descriptors = sift.detectAndCompute(images[REACH][rows, columns], region[rows, columns])
    if descriptors is None:
        return None
    corner = (columns.start, rows.start)
    start = (np.array([feature.pt for feature in features]) + corner).astype(np.float32)
    after, good = _flow(images[REACH], images[REACH + 1], start)
    moving = np.flatnonzero(good & (np.linalg.norm(after - start, axis=1) > limits.STILL))
    strength = np.array([features[point].response for point in moving])
    chosen = np.sort(moving[np.argsort(-strength, kind="stable")[: limits.MOST_MOVING]])
    if not len(chosen):
        return None
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


def _span(changes: Bools) -> slice:
    """The rows or columns that change and a margin: outside, features cost time for nothing."""
    first, last = np.flatnonzero(changes)[[0, -1]].tolist()
    return slice(max(first - limits.FEATURE_MARGIN, 0), last + limits.FEATURE_MARGIN + 1)


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

    def near(self, lag: Float64s | float, reach: float, most: int) -> Matches:
        """Those whose two times, ``lag`` seconds apart in the films, lie within ``reach`` seconds of each other; of
        more than ``most`` evenly drawn ones."""
        kept = np.flatnonzero(np.abs(self.apart - lag) <= reach)
        if len(kept) > most:
            kept = kept[spread(len(kept), most)]
        return Matches(self.first[kept], self.second[kept], self.apart[kept])


def match(
    points: tuple[MovingPoints, MovingPoints],
    apart: tuple[float, float],
    most: int = 1000,
    allowed: Callable[[Ints, Ints], Bools] | None = None,
) -> Matches:
    """Mutual nearest neighbours between keyframes that may show the same instant.

    Args:
        points: of the two films.
        apart: seconds by which the first film's keyframe is later than the second's, the least and the greatest.
        most: keyframes of the first film that are looked at, evenly spread.
        allowed: of rows of the first film's points (M,) and rows of the second's (K,), which may be the same (M, K);
            all without it.
    """
    first, second = points
    rows_a, rows_b = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for key_a in spread(len(first.key_times), most):
        in_a = first.of_keyframe(key_a)
        later = first.key_times[key_a] - second.key_times
        for key_b in np.flatnonzero((later >= apart[0]) & (later <= apart[1])):
            in_b = second.of_keyframe(int(key_b))
            if min(len(in_a), len(in_b)) < 2:
                continue
            similarity = first.descriptors[in_a] @ second.descriptors[in_b].T
            if allowed is not None:
                similarity[~allowed(in_a, in_b)] = -1.0
            a, b = mutual(similarity, limits.MATCH_RATIO, limits.MATCH_FARTHEST)
            rows_a.append(in_a[a])
            rows_b.append(in_b[b])
    a, b = np.concatenate(rows_a), np.concatenate(rows_b)
    return Matches(a, b, first.key_times[first.keyframes[a]] - second.key_times[second.keyframes[b]])
