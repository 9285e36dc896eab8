"""A line through lags at several times of a film: the drift of one clock against another, outliers aside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Bools, Float64s

_STEEPEST = 0.01  # clocks differ by a hundredth at most
_LEAST_POINTS = 3
_LEAST_SECONDS = 25.0  # a shorter film tells no drift


@dataclass(frozen=True, eq=False)
class Line:
    """``value + slope * (time - at)``.

    Attributes:
        value: seconds.
        at: seconds, the middle of the times that agree.
        slope: 1 for each second of time.
        slope_sigma: its standard deviation; infinite where too few times told it, and then the slope is 0.
        agrees: (N,) which of the points lie on it.
    """

    value: float
    at: float
    slope: float
    slope_sigma: float
    agrees: Bools


def fit_line(times: Float64s, values: Float64s, weights: Float64s, tolerance: float) -> Line:
    """The line that most weight lies within ``tolerance`` seconds of.

    Args:
        times, values: (N,) seconds, N >= 1.
        weights: (N,) positive.
        tolerance: seconds.
    """
    drifts = len(times) >= _LEAST_POINTS and float(np.ptp(times)) >= _LEAST_SECONDS
    best = _agreeing(times, values, weights, tolerance, drifts)
    t, v, w = times[best], values[best], weights[best]
    at = float(np.average(t, weights=w))
    value = float(np.average(v, weights=w))
    spread = float((w * (t - at) ** 2).sum())
    if not drifts or len(t) < _LEAST_POINTS or float(np.ptp(t)) < _LEAST_SECONDS:
        return Line(value, at, 0.0, float("inf"), best)
    slope = float((w * (t - at) * (v - value)).sum() / spread)
    scatter = v - value - slope * (t - at)
    noise = max(float((w * scatter**2).sum() / w.sum()) * len(t) / (len(t) - 2), (tolerance / 100) ** 2)
    return Line(value, at, slope, float(np.sqrt(noise * float(w.mean()) / spread)), best)


def _agreeing(times: Float64s, values: Float64s, weights: Float64s, tolerance: float, drifts: bool) -> Bools:
    """(N,) the points on the line through one point, or through two where clocks may drift, that most weight shares."""
    best, most = np.zeros(len(times), dtype=bool), -1.0
    for i in range(len(times)):
        slopes = [0.0]
        if drifts:
            far = np.flatnonzero(np.abs(times - times[i]) > _LEAST_SECONDS / 2)
            slopes += [float((values[j] - values[i]) / (times[j] - times[i])) for j in far]
        for slope in slopes:
            if abs(slope) > _STEEPEST:
                continue
            agrees = np.abs(values - values[i] - slope * (times - times[i])) <= tolerance
            weight = float(weights[agrees].sum())
            if weight > most:
                best, most = agrees, weight
    return best
