"""The finest source: at the right lag, every point that moves lies on the epipolar line of its match.

Points are carried along their own optical flow to common times, so lags are real numbers. What stands still, or moves
along its epipolar line, says nothing and is left out. A coarse search comes first, then a fine one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from ...arrays import Array, Bools, Float64s, Ints
from ..camera import Camera
from ..capture import Distortion
from ..epipolar import fundamental, sampson_distances, sampson_table
from ..video import load_opencv
from . import limits
from .films import Film
from .moving_points import REACH, Matches, MovingPoints, Search, keyframes_of, match, points_in
from .pairs import Clocks, Curve, PairLag, maxima
from .run import Run, key_of
from .starts import Motion

_ROUNDS = 8  # of reweighting


@dataclass(frozen=True, eq=False)
class Rig:
    """Films, and of those whose cameras are known these and their moving points, by the film's index.

    Attributes:
        films: all.
        cameras: at the size of the films.
        points: without lens distortion.
    """

    films: Sequence[Film]
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


def find_points(film: Film, motion: Motion, clocks: Clocks, index: int, run: Run) -> MovingPoints:
    """The moving points of a film, at every third frame; of a long one near times that all films share.

    Args:
        clocks: of all films, as far as known.
        index: the film's among them.
    """
    keyframes = _keyframes(film, clocks, index)

    def found() -> dict[str, Array]:
        points = points_in(film, motion.region, keyframes, run)
        return {part.name: getattr(points, part.name) for part in fields(points)}

    return MovingPoints(**run.work.kept("moving_points", key_of(film.state, keyframes), found))


def is_short(film: Film) -> bool:
    """Every third frame of it can be looked at."""
    return film.facts.frame_count <= limits.KEYFRAME_EVERY * limits.MOST_KEYFRAMES


def _keyframes(film: Film, clocks: Clocks, index: int) -> list[int]:
    count, every, most = film.facts.frame_count, limits.KEYFRAME_EVERY, limits.MOST_KEYFRAMES
    if is_short(film):
        step = max(1, min(every, count // limits.FEWEST_KEYFRAMES), count // most)
        return keyframes_of(range(REACH, count - REACH, step), count)
    # Frames of other films are compared only where they were taken at nearly the same time.
    apart = every * film.interval * max(1.0, count / (every * most))
    apart = 2.0 ** np.ceil(np.log2(apart))  # the same grid for all films, though they differ in length
    start, end = (clocks.capture_time(index, float(time)) for time in film.stamps[[0, -1]])
    times = np.arange(np.ceil(start / apart), np.floor(end / apart) + 1) * apart
    at = [clocks.film_time(index, float(time)) for time in times]
    return keyframes_of([int(np.abs(film.stamps - time).argmin()) for time in at], count)


def coarse_lags(rig: Rig, start: Clocks, is_sure: bool, run: Run) -> list[PairLag]:
    """Lags right to a fraction of a frame: near a start that is sure, else over all of two short films."""

    def of_pair(pair: tuple[int, int]) -> PairLag | None:
        run.check()
        lags = _range(rig, pair, start, is_sure)
        views = rig.geometry(pair, Search(lags, REACH * rig.frame(pair), limits.COARSE_KEYFRAMES))
        return epipolar_lag(pair, views, lags, limits.COARSE_STEP)

    return [lag for lag in run.in_threads("coarse offsets", of_pair, rig.pairs()) if lag is not None]


def fine_lags(rig: Rig, start: Clocks, run: Run) -> list[PairLag]:
    """Lags to a few hundredths of a frame, near clocks that are right to a frame or two."""

    def of_pair(pair: tuple[int, int]) -> PairLag | None:
        run.check()
        lags = _near(rig, pair, start, limits.FINE_FRAMES)
        search = Search(lags, REACH * rig.frame(pair), allowed=rig.along_lines(pair, start))
        return epipolar_lag(pair, rig.geometry(pair, search), lags)

    return [lag for lag in run.in_threads("offsets", of_pair, rig.pairs()) if lag is not None]


def _range(rig: Rig, pair: tuple[int, int], start: Clocks, is_sure: bool) -> tuple[float, float]:
    first, second = (rig.films[film] for film in pair)
    if is_sure or not (is_short(first) and is_short(second)):
        return _near(rig, pair, start, limits.START_FRAMES)
    least = limits.LEAST_OVERLAP * min(first.duration, second.duration)
    return least - second.duration, first.duration - least


def _near(rig: Rig, pair: tuple[int, int], start: Clocks, frames: float) -> tuple[float, float]:
    second = rig.films[pair[1]]
    ends = [start.lag(*pair, at) for at in (float(second.stamps[0]), float(second.stamps[-1]))]
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


# --- one pair of films


@dataclass(frozen=True, eq=False)
class Geometry:
    """Two views' points, matched, and how the views lie to each other.

    Attributes:
        points: of the two films, in pixels without lens distortion.
        matches: between them.
        matrix: (3, 3) fundamental matrix, first to second.
        frame: seconds between frames, of the slower film.
        width: pixels of the wider film.
        bias: (3,) pixels by ``bias_terms``: what the cameras' calibration leaves of every residual.
    """

    points: tuple[MovingPoints, MovingPoints]
    matches: Matches
    matrix: Float64s
    frame: float
    width: int
    bias: Float64s = field(default_factory=lambda: np.zeros(3))

    @property
    def truncation(self) -> float:
        """Pixels beyond which a residual is that of a false match."""
        return max(1.0, limits.TRUNCATION * self.width)

    def residuals(self, matches: Matches, lags: Float64s | float) -> tuple[Float64s, Bools]:
        """(M,) pixels at lags (M,) seconds, and which of them could be had."""
        first, second = self.points
        middle = first.times[matches.first, REACH], second.times[matches.second, REACH]
        carried = (middle[1] + lags - middle[0]) / 2  # each goes half of the way
        a, good_a = first.positions(matches.first, middle[0] + carried)
        b, good_b = second.positions(matches.second, middle[1] - carried)
        return sampson_distances(self.matrix, a, b) + self.bias_terms(matches) @ self.bias, good_a & good_b

    def bias_terms(self, matches: Matches) -> Float64s:
        """(M, 3): one, and where the points lie in the first image, in half widths from its points' middle."""
        where = self.points[0].tracks[matches.first, REACH]
        middle = self.points[0].tracks[:, REACH].mean(axis=0) if len(where) else np.zeros(2)
        return np.column_stack([np.ones(len(where)), 2 * (where - middle) / self.width])

    def slopes(self, matches: Matches, lags: Float64s | float) -> tuple[Float64s, Float64s, Bools]:
        """Residuals (M,) pixels, their derivatives (M,) in pixels a second of lag, and which could be had."""
        step = 0.25 * self.frame
        before, good_before = self.residuals(matches, lags - step)
        after, good_after = self.residuals(matches, lags + step)
        return (before + after) / 2, (after - before) / (2 * step), good_before & good_after


def epipolar_lag(
    pair: tuple[int, int], views: Geometry, lags: tuple[float, float], step: float = 0.25
) -> PairLag | None:
    """The lag between two films at which their moving points agree best; None where too few points move.

    Args:
        pair: indices of the films.
        views: their points and geometry.
        lags: the least and the greatest lag to be considered, seconds.
        step: frames between the lags that are tried first.
    """
    curve = score_curve(views, lags, step * views.frame)
    fits = []
    for start, _ in maxima(curve, views.frame, most=limits.REFINED_PEAKS):
        if (fit := _refined(pair, views, start)) is not None:
            lag, unbiased = fit
            scores = score_curve(unbiased, (lag.lag, lag.lag), step * views.frame).scores
            fits.append((float(np.nanmax(scores)) if np.isfinite(scores).any() else 0.0, lag, unbiased))
    score, best, unbiased = max(fits, key=lambda fit: fit[0], default=(0.0, None, views))
    if best is None or score <= 0:
        return None
    curve = score_curve(unbiased, lags, step * views.frame)
    others = tuple(other for other in maxima(curve, views.frame) if abs(other[0] - best.lag) >= views.frame)
    return replace(best, score=score, others=others, curve=curve)


def score_curve(views: Geometry, lags: tuple[float, float], step: float) -> Curve:
    """How many of the moving matches lie on their epipolar lines, 0 to 1, over lags."""
    grid = np.arange(np.floor(lags[0] / step), np.ceil(lags[1] / step) + 1) * step
    scores = np.full(len(grid), np.nan)
    for position, lag in enumerate(grid):
        near = views.matches.within(lag, REACH * views.frame).thinned(limits.MOST_TRIED)
        if len(near) < limits.LEAST_MATCHES:
            continue
        residuals, slopes, good = views.slopes(near, lag)
        good &= np.abs(slopes) * views.frame > limits.LEAST_SLOPE
        agreement = np.maximum(1 - (residuals[good] / views.truncation) ** 2, 0)
        scores[position] = agreement.sum() / (good.sum() + limits.DOUBT)
    return Curve(grid, scores)


def _refined(pair: tuple[int, int], views: Geometry, lag: float) -> tuple[PairLag, Geometry] | None:
    """The lag near one that is right to a frame or so, and the views with their bias; None where too few matches move.

    Reweighted least squares on residuals that are linear in the lag, in a rate where the films are long, and in where
    a point lies: cameras that were calibrated from little leave residuals that no lag can explain.
    """
    start, at, rate, sigmas = lag, 0.0, 0.0, (np.inf, np.inf)
    scale, bias = views.truncation, np.zeros(3)
    for turn in range(_ROUNDS):
        times = views.points[1].times[views.matches.second, REACH]
        predicted = lag + rate * (times - at)
        near = views.matches.within(predicted, REACH * views.frame).thinned(limits.MOST_FITTED)
        times = views.points[1].times[near.second, REACH]
        residuals, slopes, good = views.slopes(near, lag + rate * (times - at))
        bias_terms = views.bias_terms(near)
        residuals = residuals + bias_terms @ bias
        good &= (np.abs(slopes) * views.frame > limits.LEAST_SLOPE) & (np.abs(residuals) < 3 * scale)
        if good.sum() < limits.LEAST_MATCHES:
            return None
        r, g, t = residuals[good], slopes[good], times[good]
        weights = np.maximum(1 - (r / (3 * scale)) ** 2, 0) ** 2  # Tukey's
        noise = float((weights * r**2).sum() / max(weights.sum(), 1e-9))
        middle = float(np.average(t, weights=weights * g**2 + 1e-12))
        lag, at = lag + rate * (middle - at), middle
        drifts = bool(np.ptp(t) >= limits.MOTION_DRIFT_SECONDS) and turn >= 2
        clocks = [g, g * (t - middle)] if drifts else [g]
        columns = np.column_stack([*clocks, bias_terms[good]])
        prior = np.zeros(columns.shape[1])
        prior[-3:] = limits.CORRELATED * noise / (limits.BIAS * views.width) ** 2
        normal = columns.T @ (weights[:, None] * columns) + np.diag(prior + 1e-12)
        pulled = np.concatenate([np.zeros(len(clocks)), bias])  # the prior is that there is no bias
        change = -np.linalg.solve(normal, columns.T @ (weights * r) + prior * pulled)
        lag += float(np.clip(change[0], -views.frame / 2, views.frame / 2))
        rate += float(change[1]) if drifts else 0.0
        bias = bias + change[-3:]
        scale = max(0.1, 0.5 * scale, min(scale, 2.5 * float(np.median(np.abs(r)))))
        inverse = np.linalg.inv(normal) * limits.CORRELATED * noise
        sigmas = (float(np.sqrt(inverse[0, 0])), float(np.sqrt(inverse[1, 1])) if drifts else np.inf)
    if abs(lag - start) > 2 * views.frame and abs(rate) < limits.SLOWEST:
        return None
    sigma = max(sigmas[0], 1e-3 * views.frame)
    return PairLag(*pair, lag, at, sigma, 0.0, "motion", 1 + rate, sigmas[1]), replace(views, bias=bias)
