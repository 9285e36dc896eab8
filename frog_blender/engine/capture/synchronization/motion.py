"""Moving points of all films and the lags that their epipolar residuals give: a coarse search, then a fine one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from hashlib import blake2b

import numpy as np

from ...arrays import Bools, Ints
from ..camera import Camera
from .epipolar import Geometry, epipolar_lag, fundamental, residual_table, score_curve
from .look import Look
from .matches import Search, match
from .moving_points import REACH, MovingPoints, PointFinder, keyframes_of
from .pair import PairLag
from .recordings import Recording
from .solve import Clocks
from .work import Kept, Work, in_threads

_EVERY = 3  # frames between keyframes at most: points are tracked so far that no time is missed
_FEWEST_KEYFRAMES = 15  # of a film that has so many frames
_MOST_KEYFRAMES = 40
_NEIGHBORS = 6  # films that each is compared with
_LEAST_OVERLAP = 0.25  # of the shorter film
_COARSE_KEYFRAMES = 8
_COARSE_STEP = 0.5  # frames
_FINE_FRAMES = 2.0  # to either side of the coarse answer
_BAND = 4.0  # truncations to either side of an epipolar line in which a match is sought
_START_FRAMES = 4.0  # to either side of a start that many films agree on


@dataclass(frozen=True, eq=False)
class Rig:
    """Films whose cameras are known.

    Attributes:
        films: one a camera.
        cameras: theirs, at the size of the films.
        points: their moving points, without lens distortion.
    """

    films: tuple[Recording, ...]
    cameras: tuple[Camera, ...]
    points: tuple[MovingPoints, ...]

    def pairs(self) -> list[tuple[int, int]]:
        """Each camera with those that look at the scene most alike."""
        forward = np.array([camera.forward for camera in self.cameras])
        alike = forward @ forward.T
        np.fill_diagonal(alike, -np.inf)
        nearest = np.argsort(-alike, axis=1, kind="stable")[:, :_NEIGHBORS]
        return sorted({(min(i, int(j)), max(i, int(j))) for i, row in enumerate(nearest) for j in row if i != j})

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
        band = _BAND * max(1.0, 0.005 * max(camera.width for camera in cameras))

        def allowed(in_first: Ints, in_second: Ints) -> Bools:
            time_a, time_b = first.times[in_first[0], REACH], second.times[in_second[0], REACH]
            half = (time_b + clocks.lag(*pair, time_b) - time_a) / 2
            a, _ = first.positions(in_first, np.full(len(in_first), time_a + half))
            b, _ = second.positions(in_second, np.full(len(in_second), time_b - half))
            return np.abs(residual_table(matrix, a, b)) < band

        return allowed


def find_points(
    film: Recording, look: Look, clocks: Clocks | None, number: int, work: Work, kept: Kept | None = None
) -> MovingPoints:
    """The moving points of a film, at every third frame; of a long one near times that all films share.

    Args:
        clocks: of all films, as far as known; None where nothing is.
        number: the film's index among them.
        kept: where they may be found, and are kept.
    """
    keyframes = _keyframes(film, clocks, number)
    key = f"{film.key}{blake2b(np.array(keyframes, np.int64).tobytes(), digest_size=8).hexdigest()}"
    if kept is not None and (arrays := kept.load("moving_points", key)) is not None:
        return MovingPoints(**arrays)
    finder = PointFinder(film, look.changing, keyframes)
    wanted = finder.needed
    for position, (index, gray) in enumerate(zip(wanted, film.gray(wanted), strict=True)):
        if position % 5 == 0:
            work.step(f"Finding moving points in {film.name}", position, len(wanted))
        finder.add(index, gray)
    points = finder.points()
    if kept is not None:
        kept.keep("moving_points", key, {each.name: getattr(points, each.name) for each in fields(points)})
    return points


def is_short(film: Recording) -> bool:
    """Every third frame of it can be looked at."""
    return len(film.timestamps) <= _EVERY * _MOST_KEYFRAMES


def _keyframes(film: Recording, clocks: Clocks | None, number: int) -> list[int]:
    count = len(film.timestamps)
    if is_short(film) or clocks is None:
        step = max(1, min(_EVERY, count // _FEWEST_KEYFRAMES), count // _MOST_KEYFRAMES)
        return keyframes_of(range(REACH, count - REACH, step), count)
    # Frames of other films are compared only where they were taken at nearly the same time.
    apart = _EVERY * film.interval * max(1.0, count / (_EVERY * _MOST_KEYFRAMES))
    apart = 2.0 ** np.ceil(np.log2(apart))  # the same grid for all films, though they differ in length
    shown = clocks.capture_time(number, float(film.timestamps[0])), clocks.capture_time(number, film.timestamps[-1])
    times = np.arange(np.ceil(shown[0] / apart), np.floor(shown[1] / apart) + 1) * apart
    at = [clocks.film_time(number, float(time)) for time in times]
    nearest = [int(np.abs(film.timestamps - time).argmin()) for time in at]
    return keyframes_of(nearest, count)


def coarse_lags(rig: Rig, start: Clocks, is_sure: bool, work: Work) -> list[PairLag]:
    """Lags right to a fraction of a frame: near a start that is sure, else over all of two short films."""
    pairs = rig.pairs()

    def of_pair(number: int) -> PairLag | None:
        work.step("Comparing moving points", number, len(pairs))
        pair = pairs[number]
        lags = _range(rig, pair, start, is_sure)
        views = rig.geometry(pair, Search(lags, REACH * rig.frame(pair), _COARSE_KEYFRAMES))
        return epipolar_lag(pair, views, lags, _COARSE_STEP)

    return [lag for lag in in_threads(of_pair, range(len(pairs))) if lag is not None]


def fine_lags(rig: Rig, start: Clocks, work: Work) -> list[PairLag]:
    """Lags to a few hundredths of a frame, near clocks that are right to a frame or two."""
    pairs = rig.pairs()

    def of_pair(number: int) -> PairLag | None:
        work.step("Measuring offsets", number, len(pairs))
        pair = pairs[number]
        lags = _near(rig, pair, start, _FINE_FRAMES)
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
            search = Search(lags, REACH * rig.frame(pair), _COARSE_KEYFRAMES, rig.along_lines(pair, moved))
            curve = score_curve(rig.geometry(pair, search), lags, _COARSE_STEP * rig.frame(pair))
            if np.isfinite(curve.scores).any():
                scores.append(float(np.nanmax(curve.scores)))
    return float(np.mean(scores)) if scores else float("nan")


def _range(rig: Rig, pair: tuple[int, int], start: Clocks, is_sure: bool) -> tuple[float, float]:
    first, second = (rig.films[film] for film in pair)
    if is_sure or not (is_short(first) and is_short(second)):
        return _near(rig, pair, start, _START_FRAMES)
    least = _LEAST_OVERLAP * min(first.duration, second.duration)
    return least - second.duration, first.duration - least


def _near(rig: Rig, pair: tuple[int, int], start: Clocks, frames: float) -> tuple[float, float]:
    second = rig.films[pair[1]]
    ends = [start.lag(*pair, at) for at in (float(second.timestamps[0]), float(second.timestamps[-1]))]
    reach = frames * rig.frame(pair)
    return min(ends) - reach, max(ends) + reach
