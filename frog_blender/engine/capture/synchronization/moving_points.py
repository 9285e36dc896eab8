"""Points that move in one camera's film: SIFT features inside the changing region, tracked by optical flow.

Each is tracked for a few frames to either side of the frame it was found in, so that its position is known at every
time between: films of other cameras show the same point at times between these frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray, Ints
from ..video import load_opencv
from .recordings import Recording

REACH = 2
"""Frames to either side of its own in which a point is tracked."""
_NODES = 2 * REACH + 1
_MOST_FOUND, _MOST = 1200, 350  # features a frame, and those of them kept that move
_CONTRAST = 0.01  # OpenCV's 0.04 loses small and dark images
_STILL = 0.15  # pixels a frame: what moves less tells no time
_MARGIN = 24  # pixels about the changing region that its features may look at
_WINDOW = (15, 15)  # pixels, of the optical flow
_LEVELS = 3
_BACK = 0.5  # pixels by which a point tracked there and back may miss where it started
_BEYOND = 0.6  # frames by which a track may be continued beyond its ends


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
        holds = (at >= t[:, 0] - _BEYOND * frame) & (at <= t[:, 2] + _BEYOND * frame)
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


def keyframes_of(indices: Sequence[int], frame_count: int) -> list[int]:
    """Those of the wanted frames that have REACH frames to either side."""
    return sorted({index for index in indices if REACH <= index < frame_count - REACH})


class PointFinder:
    """Receives the frames that ``needed`` names, in order, and finds the points of its keyframes."""

    def __init__(self, film: Recording, mask: ImageArray, keyframes: Sequence[int]) -> None:
        """``mask`` (H, W) uint8 of the gray images; ``keyframes`` come from keyframes_of."""
        cv2 = load_opencv()
        self._film, self._mask, self._keyframes = film, mask, list(keyframes)
        self._sift = cv2.SIFT_create(nfeatures=_MOST_FOUND, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
        self._inside = _bounds(mask)
        self._recent: dict[int, ImageArray] = {}
        self._parts: list[tuple[int, Float64s, Float32s]] = []

    @property
    def needed(self) -> list[int]:
        """Indices of the frames to be given, ascending."""
        return sorted({key + shift for key in self._keyframes for shift in range(-REACH, REACH + 1)})

    def add(self, index: int, gray: ImageArray) -> None:
        """The frame ``index``, (H, W) uint8."""
        self._recent[index] = gray
        key = index - REACH
        if key in self._keyframes and self._mask.any():
            found = self._find([self._recent[key + shift] for shift in range(-REACH, REACH + 1)])
            if found is not None:
                self._parts.append((key, *found))
        self._recent.pop(index - 2 * REACH, None)

    def points(self) -> MovingPoints:
        """All points found."""
        stamps = self._film.timestamps
        key_times = stamps[self._keyframes] if self._keyframes else np.zeros(0)
        order = {key: number for number, key in enumerate(self._keyframes)}
        counts = [len(part[1]) for part in self._parts]
        keyframes = np.repeat(np.array([order[part[0]] for part in self._parts], dtype=np.int64), counts)
        shifts = np.arange(-REACH, REACH + 1)
        frames = np.repeat(np.array([part[0] for part in self._parts], dtype=np.int64), counts)
        tracks = np.concatenate([part[1] for part in self._parts]) if counts else np.zeros((0, _NODES, 2))
        descriptors = np.concatenate([part[2] for part in self._parts]) if counts else np.zeros((0, 128), np.float32)
        # Gray images are scaled: back to pixels of the film, whose centres lie at +0.5.
        tracks = (tracks + 0.5) / self._film.scale
        return MovingPoints(keyframes, key_times, stamps[frames[:, None] + shifts], tracks, descriptors)

    def _find(self, images: list[ImageArray]) -> tuple[Float64s, Float32s] | None:
        """Tracks (M, 5, 2) in pixels of the gray images and descriptors (M, 128); None without features."""
        rows, columns = self._inside
        found, descriptors = self._sift.detectAndCompute(images[REACH][rows, columns], self._mask[rows, columns])
        if descriptors is None or not len(found):
            return None
        corner = (columns.start, rows.start)
        start = (np.array([point.pt for point in found]) + corner).astype(np.float32)
        after, good = _flow(images[REACH], images[REACH + 1], start)
        moving = np.flatnonzero(good & (np.linalg.norm(after - start, axis=1) > _STILL))
        if not len(moving):
            return None
        strength = np.array([found[point].response for point in moving])
        chosen = np.sort(moving[np.argsort(-strength, kind="stable")[:_MOST]])
        start = start[chosen]
        tracks = np.full((len(start), _NODES, 2), np.nan)
        tracks[:, REACH] = start
        for direction in (-1, 1):
            position, alive = start, np.ones(len(start), dtype=bool)
            for step in range(1, REACH + 1):
                before = images[REACH + direction * (step - 1)]
                position, good = _flow(before, images[REACH + direction * step], position)
                alive &= good
                tracks[alive, REACH + direction * step] = position[alive]
        tracked = np.isfinite(tracks[:, REACH - 1 : REACH + 2, 0]).all(axis=1)
        kept, tracks = chosen[tracked], tracks[tracked]
        roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
        return tracks, roots[kept].astype(np.float32)


def _bounds(mask: ImageArray) -> tuple[slice, slice]:
    """Rows and columns of a mask (H, W) that hold all of it and a margin: outside, features cost time for nothing."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    top, left = max(int(rows[0]) - _MARGIN, 0), max(int(columns[0]) - _MARGIN, 0)
    return slice(top, int(rows[-1]) + _MARGIN + 1), slice(left, int(columns[-1]) + _MARGIN + 1)


def _flow(before: ImageArray, after: ImageArray, points: Float32s) -> tuple[Float32s, Bools]:
    """Where points (N, 2) went, and which of them came back to where they started."""
    cv2 = load_opencv()
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    options = {"winSize": _WINDOW, "maxLevel": _LEVELS, "criteria": criteria}
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, points[:, None], None, **options)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(after, before, there, None, **options)
    missed = np.linalg.norm(back[:, 0] - points, axis=1)
    good = (found[:, 0] > 0) & (returned[:, 0] > 0) & (missed < _BACK)
    return there[:, 0], good
