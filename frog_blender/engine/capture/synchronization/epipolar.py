"""The finest source: at the right lag, every point that moves lies on the epipolar line of its match.

Points are carried along their own optical flow to common times, so lags are real numbers. What stands still, or moves
along its epipolar line, says nothing and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s
from ..camera import Camera
from .matches import Matches
from .moving_points import REACH, MovingPoints
from .pair import Curve, PairLag, maxima

_LEAST_SLOPE = 0.25  # pixels a frame by which the residual must change with the lag
_TRUNCATION = 0.005  # of the width, at least one pixel: residuals beyond are false matches
_MOST_TRIED, _MOST_FITTED = 600, 3000  # matches at each lag of the curve, and in the fine search
_DOUBT = 10.0  # a score of few matches is taken as if so many more had failed
_LEAST = 12  # matches that the fine search needs
_ROUNDS = 8
_DRIFT_SECONDS = 15.0  # two clocks' rates are told apart only where matches spread over so much time
_SLOWEST = 5e-6  # what two quartz clocks differ in at least: a smaller rate is no rate
_NEAR = REACH  # frames by which two points may be apart: each is carried half of the way


def fundamental(first: Camera, second: Camera) -> Float64s:
    """(3, 3) F with x_second^T F x_first = 0 for pixel positions of the same point of the world."""
    relative = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
    x, y, z = relative[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    essential = cross @ relative[:3, :3]
    matrix: Float64s = np.linalg.inv(second.intrinsics).T @ essential @ np.linalg.inv(first.intrinsics)
    return matrix / max(float(np.linalg.norm(matrix)), 1e-30)


def signed_residuals(matrix: Float64s, first: Float64s, second: Float64s) -> Float64s:
    """(M,) Sampson residuals in pixels, with sign, of positions (M, 2) in two images."""
    a = np.concatenate([first, np.ones((len(first), 1))], axis=1)
    b = np.concatenate([second, np.ones((len(second), 1))], axis=1)
    lines_b, lines_a = a @ matrix.T, b @ matrix
    product = (b * lines_b).sum(axis=1)
    length = np.sqrt((lines_b[:, :2] ** 2).sum(axis=1) + (lines_a[:, :2] ** 2).sum(axis=1))
    result: Float64s = product / np.maximum(length, 1e-30)
    return result


def residual_table(matrix: Float64s, first: Float64s, second: Float64s) -> Float64s:
    """(M, K) Sampson residuals in pixels, with sign, of every position (M, 2) with every position (K, 2)."""
    a = np.concatenate([first, np.ones((len(first), 1))], axis=1)
    b = np.concatenate([second, np.ones((len(second), 1))], axis=1)
    lines_b, lines_a = a @ matrix.T, b @ matrix
    squares = (lines_b[:, :2] ** 2).sum(axis=1)[:, None] + (lines_a[:, :2] ** 2).sum(axis=1)
    result: Float64s = (lines_b @ b.T) / np.sqrt(np.maximum(squares, 1e-60))
    return result


@dataclass(frozen=True, eq=False)
class Geometry:
    """Two views' points, matched, and how the views lie to each other.

    Attributes:
        points: of the two films, in pixels without lens distortion.
        matches: between them.
        matrix: (3, 3) fundamental matrix, first to second.
        frame: seconds between frames, of the slower film.
        width: pixels of the wider film.
    """

    points: tuple[MovingPoints, MovingPoints]
    matches: Matches
    matrix: Float64s
    frame: float
    width: int

    @property
    def truncation(self) -> float:
        """Pixels beyond which a residual is that of a false match."""
        return max(1.0, _TRUNCATION * self.width)

    def residuals(self, matches: Matches, lags: Float64s | float) -> tuple[Float64s, Bools]:
        """(M,) pixels at lags (M,) seconds, and which of them could be had."""
        first, second = self.points
        middle = first.times[matches.first, REACH], second.times[matches.second, REACH]
        carried = (middle[1] + lags - middle[0]) / 2  # each goes half of the way
        a, good_a = first.positions(matches.first, middle[0] + carried)
        b, good_b = second.positions(matches.second, middle[1] - carried)
        return signed_residuals(self.matrix, a, b), good_a & good_b

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
    curve = _curve(views, lags, step * views.frame)
    found = maxima(curve, views.frame)
    if not found or found[0][1] <= 0:
        return None
    best = _refined(views, found[0][0])
    if best is None:
        return None
    lag, at, sigma, rate, rate_sigma = best
    return PairLag(
        first=pair[0],
        second=pair[1],
        lag=lag,
        at=at,
        sigma=sigma,
        score=found[0][1],
        source="motion",
        rate=rate,
        rate_sigma=rate_sigma,
        others=tuple(found[1:]),
        curve=curve,
    )


def _curve(views: Geometry, lags: tuple[float, float], step: float) -> Curve:
    """How many of the moving matches lie on their epipolar lines, 0 to 1, over lags."""
    grid = np.arange(np.floor(lags[0] / step), np.ceil(lags[1] / step) + 1) * step
    scores = np.full(len(grid), np.nan)
    for position, lag in enumerate(grid):
        near = views.matches.within(lag, _NEAR * views.frame).thinned(_MOST_TRIED)
        if len(near) < _LEAST:
            continue
        residuals, slopes, good = views.slopes(near, lag)
        good &= np.abs(slopes) * views.frame > _LEAST_SLOPE
        agreement = np.maximum(1 - (residuals[good] / views.truncation) ** 2, 0)
        scores[position] = agreement.sum() / (good.sum() + _DOUBT)
    return Curve(grid, scores)


def _refined(views: Geometry, lag: float) -> tuple[float, float, float, float, float] | None:
    """Lag, the second film's time it holds at, its sigma, the first film's rate by the second's, and its sigma.

    Reweighted least squares on residuals that are linear in the lag, and in a rate where the films are long.
    """
    start, at, rate, sigmas = lag, 0.0, 0.0, (np.inf, np.inf)
    scale = views.truncation
    for turn in range(_ROUNDS):
        times = views.points[1].times[views.matches.second, REACH]
        predicted = lag + rate * (times - at)
        near = views.matches.within(predicted, _NEAR * views.frame).thinned(_MOST_FITTED)
        times = views.points[1].times[near.second, REACH]
        local = lag + rate * (times - at)
        residuals, slopes, good = views.slopes(near, local)
        good &= (np.abs(slopes) * views.frame > _LEAST_SLOPE) & (np.abs(residuals) < 3 * scale)
        if good.sum() < _LEAST:
            return None
        r, g, t = residuals[good], slopes[good], times[good]
        weights = np.maximum(1 - (r / (3 * scale)) ** 2, 0) ** 2  # Tukey's
        middle = float(np.average(t, weights=weights * g**2 + 1e-12))
        lag, at = lag + rate * (middle - at), middle
        drifts = bool(np.ptp(t) >= _DRIFT_SECONDS) and turn >= 2
        columns = np.stack([g, g * (t - middle)], axis=1) if drifts else g[:, None]
        normal = columns.T @ (weights[:, None] * columns)
        change = -np.linalg.solve(normal + 1e-12 * np.eye(len(normal)), columns.T @ (weights * r))
        lag += float(np.clip(change[0], -views.frame / 2, views.frame / 2))
        rate += float(change[1]) if drifts else 0.0
        scale = max(0.1, 0.5 * scale, min(scale, 2.5 * float(np.median(np.abs(r)))))
        noise = float((weights * r**2).sum() / max(weights.sum(), 1e-9))
        # Neighbouring points and successive keyframes err together: count one in four.
        inverse = np.linalg.inv(normal + 1e-12 * np.eye(len(normal))) * 4 * noise
        sigmas = (float(np.sqrt(inverse[0, 0])), float(np.sqrt(inverse[-1, -1])) if drifts else np.inf)
    if abs(lag - start) > 2 * views.frame and abs(rate) < _SLOWEST:
        return None
    return lag, at, max(sigmas[0], 1e-3 * views.frame), 1 + rate, sigmas[1]
