"""Moving points of all films whose cameras are known, and the lags between them: a coarse search, then a fine one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from hashlib import blake2b

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..camera import Camera
from ..capture import Distortion
from ..epipolar import fundamental, sampson_table
from ..video import load_opencv
from . import limits
from .epipolar_lags import Geometry, epipolar_lag, score_curve
from .moving_points import REACH, MovingPoints, Search, keyframes_of, match, points_in
from .pairs import Clocks, PairLag
from .recordings import Motion, Recording
from .work import Kept, Work, in_threads


@dataclass(frozen=True, eq=False)
class Rig:
    """Films, and of those whose cameras are known these and their moving points, by the film's index.

    Attributes:
        films: all.
        cameras: at the size of the films.
        points: without lens distortion.
    """

    films: Sequence[Recording]
    cameras: Mapping[int, Camera]
    points: Mapping[int, MovingPoints]

    def pairs(self) -> list[tuple[int, int]]:
        """Each camera with those that look at the scene most alike."""
        known = np.array(list(self.cameras))
        forward = np.array([camera.forward for camera in self.cameras.values()])
        alike = forward @ forward.T
        np.fill_diagonal(alike, -np.inf)
        nearest = known[np.argsort(-alike, axis=1, kind="stable")[:, : limits.NEIGHBORS]]
        pairs = {(min(i, j), max(i, j)) for i, row in zip(known.tolist(), nearest.tolist(), strict=True) for j in row}
        return sorted(pair for pair in pairs if pair[0] != pair[1])

    def frame(self, pair: tuple[int, int]) -> float:
        """Seconds between frames of the slower of two films."""
        return max(self.films[film].interval for film in pair)

    def geometry(self, pair: tuple[int, int], search: Search) -> Geometry:
        """Two films' points and the matches that a search finds."""
        first, second = (self.points[film] for film in pair)
        cameras = [self.cameras[film] for film in pair]
        width = max(camera.width for camera in cameras)
        matrix = fundamental(cameras[0], cameras[1])
        return Geometry((first, second), match(first, second, search), matrix, self.frame(pair), width)

    def along_lines(self, pair: tuple[int, int], clocks: Clocks) -> Callable[[Ints, Ints], Bools]:
        """Which points of two films lie near each other's epipolar lines, by clocks that are nearly right.

        Fewer rivals pass the ratio test the more: several times as many matches where little has texture.
        """
        first, second = (self.points[film] for film in pair)
        cameras = [self.cameras[film] for film in pair]
        matrix = fundamental(cameras[0], cameras[1])
        band = limits.BAND * max(1.0, 0.005 * max(camera.width for camera in cameras))

        def allowed(in_first: Ints, in_second: Ints) -> Bools:
            time_a, time_b = first.times[in_first[0], REACH], second.times[in_second[0], REACH]
            half = (time_b + clocks.lag(*pair, time_b) - time_a) / 2
            a, _ = first.positions(in_first, np.full(len(in_first), time_a + half))
            b, _ = second.positions(in_second, np.full(len(in_second), time_b - half))
            return np.abs(sampson_table(matrix, a, b)) < band

        return allowed


def find_points(
    film: Recording, motion: Motion, clocks: Clocks, index: int, work: Work, kept: Kept | None = None
) -> MovingPoints:
    """The moving points of a film, at every third frame; of a long one near times that all films share.

    Args:
        clocks: of all films, as far as known.
        index: the film's among them.
        kept: where they may be found, and are kept.
    """
    keyframes = _keyframes(film, clocks, index)
    key = f"{film.key}{blake2b(np.array(keyframes, np.int64).tobytes(), digest_size=8).hexdigest()}"
    if kept is not None and (arrays := kept.load("moving_points", key)) is not None:
        return MovingPoints(**arrays)
    points = points_in(film, motion.region, keyframes, work)
    if kept is not None:
        kept.keep("moving_points", key, {field.name: getattr(points, field.name) for field in fields(points)})
    return points


def is_short(film: Recording) -> bool:
    """Every third frame of it can be looked at."""
    return len(film.timestamps) <= limits.KEYFRAME_EVERY * limits.MOST_KEYFRAMES


def _keyframes(film: Recording, clocks: Clocks, index: int) -> list[int]:
    count, every, most = len(film.timestamps), limits.KEYFRAME_EVERY, limits.MOST_KEYFRAMES
    if is_short(film):
        step = max(1, min(every, count // limits.FEWEST_KEYFRAMES), count // most)
        return keyframes_of(range(REACH, count - REACH, step), count)
    # Frames of other films are compared only where they were taken at nearly the same time.
    apart = every * film.interval * max(1.0, count / (every * most))
    apart = 2.0 ** np.ceil(np.log2(apart))  # the same grid for all films, though they differ in length
    start, end = (clocks.capture_time(index, float(time)) for time in film.timestamps[[0, -1]])
    times = np.arange(np.ceil(start / apart), np.floor(end / apart) + 1) * apart
    at = [clocks.film_time(index, float(time)) for time in times]
    return keyframes_of([int(np.abs(film.timestamps - time).argmin()) for time in at], count)


def coarse_lags(rig: Rig, start: Clocks, is_sure: bool, work: Work) -> list[PairLag]:
    """Lags right to a fraction of a frame: near a start that is sure, else over all of two short films."""
    pairs = rig.pairs()

    def of_pair(index: int) -> PairLag | None:
        work.step("Comparing moving points", index, len(pairs))
        pair = pairs[index]
        lags = _range(rig, pair, start, is_sure)
        views = rig.geometry(pair, Search(lags, REACH * rig.frame(pair), limits.COARSE_KEYFRAMES))
        return epipolar_lag(pair, views, lags, limits.COARSE_STEP)

    return [lag for lag in in_threads(of_pair, range(len(pairs))) if lag is not None]


def fine_lags(rig: Rig, start: Clocks, work: Work) -> list[PairLag]:
    """Lags to a few hundredths of a frame, near clocks that are right to a frame or two."""
    pairs = rig.pairs()

    def of_pair(index: int) -> PairLag | None:
        work.step("Measuring offsets", index, len(pairs))
        pair = pairs[index]
        lags = _near(rig, pair, start, limits.FINE_FRAMES)
        search = Search(lags, REACH * rig.frame(pair), allowed=rig.along_lines(pair, start))
        return epipolar_lag(pair, rig.geometry(pair, search), lags)

    return [lag for lag in in_threads(of_pair, range(len(pairs))) if lag is not None]


def score_at(rig: Rig, film: int, offset: float, clocks: Clocks) -> float:
    """How well a film's moving points agree with the others' if its offset were that, seconds; NaN if nothing tells."""
    offsets = clocks.offsets.copy()
    offsets[film] = offset
    moved, scores = replace(clocks, offsets=offsets), []
    for pair in rig.pairs():
        if film in pair:
            lags = _near(rig, pair, moved, 1.0)
            search = Search(lags, REACH * rig.frame(pair), limits.COARSE_KEYFRAMES, rig.along_lines(pair, moved))
            curve = score_curve(rig.geometry(pair, search), lags, limits.COARSE_STEP * rig.frame(pair))
            if np.isfinite(curve.scores).any():
                scores.append(float(np.nanmax(curve.scores)))
    return float(np.mean(scores)) if scores else float("nan")


def _range(rig: Rig, pair: tuple[int, int], start: Clocks, is_sure: bool) -> tuple[float, float]:
    first, second = (rig.films[film] for film in pair)
    if is_sure or not (is_short(first) and is_short(second)):
        return _near(rig, pair, start, limits.START_FRAMES)
    least = limits.LEAST_OVERLAP * min(first.duration, second.duration)
    return least - second.duration, first.duration - least


def _near(rig: Rig, pair: tuple[int, int], start: Clocks, frames: float) -> tuple[float, float]:
    second = rig.films[pair[1]]
    ends = [start.lag(*pair, at) for at in (float(second.timestamps[0]), float(second.timestamps[-1]))]
    reach = frames * rig.frame(pair)
    return min(ends) - reach, max(ends) + reach


def straightened(camera: Camera, distortion: Distortion | None, positions: Float64s) -> Float64s:
    """Positions (..., 2) in pixels of ``camera``, pixel centres at +0.5, without its lens's distortion; NaN stays."""
    if distortion is None or not positions.size:
        return positions
    cv2 = load_opencv()
    lens = camera.intrinsics.copy()
    lens[:2, 2] -= 0.5  # OpenCV counts pixel centres from 0
    straight: Float64s = positions.reshape(-1, 2).copy()
    known = np.isfinite(straight).all(axis=1)
    if known.any():
        given = np.ascontiguousarray(straight[known] - 0.5)
        given[:, 0] -= distortion.skew * lens[0, 0] * (given[:, 1] - lens[1, 2]) / lens[1, 1]
        straight[known] = cv2.undistortPoints(given[:, None], lens, distortion.coefficients, P=lens)[:, 0] + 0.5
    return straight.reshape(positions.shape)
