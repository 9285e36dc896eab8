"""The finest source: at the right lag, every point that moves lies on the epipolar line of its match.

Points are carried along their own optical flow to common times, so lags are real numbers. What stands still, or moves
along its epipolar line, says nothing and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...arrays import Bools, Float64s
from ..epipolar import sampson_distances
from . import limits
from .moving_points import REACH, Matches, MovingPoints
from .pairs import Curve, PairLag, maxima

_ROUNDS = 8  # of reweighting


@dataclass(frozen=True, eq=False)
class Geometry:
    """Two views' points, matched, and how the views lie to each other.

    Attributes:
        points: of the two films, in pixels without lens distortion.
        matches: between them.
        matrix: (3, 3) fundamental matrix, first to second.
        frame: seconds between frames, of the slower film.
        width: pixels of the wider film.
        bias: (3,) pixels by ``places``: what the cameras' calibration leaves of every residual.
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
        return sampson_distances(self.matrix, a, b) + self.places(matches) @ self.bias, good_a & good_b

    def places(self, matches: Matches) -> Float64s:
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
    best: tuple[float, _Fit, Curve] | None = None
    for start, _ in maxima(curve, views.frame, most=limits.REFINED_PEAKS):
        fit = _refined(views, start)
        if fit is None:
            continue
        adjusted = score_curve(replace(views, bias=fit.bias), (fit.lag, fit.lag), step * views.frame)
        score = float(np.nanmax(adjusted.scores)) if np.isfinite(adjusted.scores).any() else 0.0
        if score > 0 and (best is None or score > best[0]):
            best = score, fit, adjusted
    if best is None:
        return None
    score, fit, _ = best
    if np.any(fit.bias):
        curve = score_curve(replace(views, bias=fit.bias), lags, step * views.frame)
    others = [other for other in maxima(curve, views.frame) if abs(other[0] - fit.lag) >= views.frame]
    return PairLag(
        first=pair[0],
        second=pair[1],
        lag=fit.lag,
        at=fit.at,
        sigma=fit.sigma,
        score=score,
        source="motion",
        rate=fit.rate,
        rate_sigma=fit.rate_sigma,
        others=tuple(others),
        curve=curve,
    )


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


@dataclass(frozen=True, eq=False)
class _Fit:
    """A lag as PairLag has it, and the bias that was found with it."""

    lag: float
    at: float
    sigma: float
    rate: float
    rate_sigma: float
    bias: Float64s


def _refined(views: Geometry, lag: float) -> _Fit | None:
    """The lag near one that is right to a frame or so; None where too few matches move.

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
        places = views.places(near)
        residuals = residuals + places @ bias
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
        columns = np.column_stack([*clocks, places[good]])
        prior = np.zeros(columns.shape[1])
        prior[-3:] = limits.CORRELATED * noise / (limits.BIAS * views.width) ** 2
        normal = columns.T @ (weights[:, None] * columns) + np.diag(prior + 1e-12)
        pulled = np.concatenate([np.zeros(len(clocks)), bias])  # the prior is that there is no bias
        wanted = columns.T @ (weights * r) + prior * pulled
        change = -np.linalg.solve(normal, wanted)
        lag += float(np.clip(change[0], -views.frame / 2, views.frame / 2))
        rate += float(change[1]) if drifts else 0.0
        bias = bias + change[-3:]
        scale = max(0.1, 0.5 * scale, min(scale, 2.5 * float(np.median(np.abs(r)))))
        inverse = np.linalg.inv(normal) * limits.CORRELATED * noise
        sigmas = (float(np.sqrt(inverse[0, 0])), float(np.sqrt(inverse[1, 1])) if drifts else np.inf)
    if abs(lag - start) > 2 * views.frame and abs(rate) < limits.SLOWEST:
        return None
    return _Fit(lag, at, max(sigmas[0], 1e-3 * views.frame), 1 + rate, sigmas[1], bias)
