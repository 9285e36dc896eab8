"""What one source says about two films: the lag between their clocks, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...arrays import Float64s

Source = Literal["audio", "energy", "motion", "tracks"]
"""``motion``: epipolar residuals of moving points, the finest; ``tracks``: of points known by name, as joints are."""

RIVAL = 0.9
"""A runner-up with this share of the best score is as likely."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A score over lags, for a person to look at.

    Attributes:
        lags: (L,) float64 seconds, ascending.
        scores: (L,) float64; the greater the better, NaN where nothing could be compared.
    """

    lags: Float64s
    scores: Float64s


def no_curve() -> Curve:
    return Curve(np.zeros(0), np.zeros(0))


@dataclass(frozen=True, eq=False)
class PairLag:
    """The same instant in two films: the first shows it at ``at + lag``, the second at ``at`` (seconds of each film).

    Attributes:
        first, second: indices of the films.
        lag: seconds.
        at: seconds in the second film for which ``lag`` holds; matters only where the clocks differ in rate.
        sigma: standard deviation of ``lag``, seconds, as the source estimates it.
        score: how well the films agree at ``lag``, 0 to 1.
        source: who says so.
        rate: seconds of the first film for each second of the second.
        rate_sigma: standard deviation of ``rate``; infinite where the source assumed it.
        others: other lags (seconds) with their scores, best first: where the score has further maxima.
        curve: the score over lags.
    """

    first: int
    second: int
    lag: float
    at: float
    sigma: float
    score: float
    source: Source
    rate: float = 1.0
    rate_sigma: float = float("inf")
    others: tuple[tuple[float, float], ...] = ()
    curve: Curve = field(default_factory=no_curve)

    @property
    def rivals(self) -> tuple[float, ...]:
        """Lags whose score comes within a tenth of the best."""
        return tuple(lag for lag, score in self.others if score >= RIVAL * self.score)


def maxima(curve: Curve, apart: float, most: int = 4) -> list[tuple[float, float]]:
    """The highest local maxima (lag, score) of a curve, best first, at least ``apart`` seconds from each other.

    Peaks lie between samples where a parabola through three of them says so.
    """
    scores = np.where(np.isfinite(curve.scores), curve.scores, -np.inf)
    if not len(scores) or not np.isfinite(scores).any():
        return []
    padded = np.concatenate([[-np.inf], scores, [-np.inf]])
    peaks = np.flatnonzero((scores >= padded[:-2]) & (scores >= padded[2:]) & np.isfinite(scores))
    found: list[tuple[float, float]] = []
    for peak in peaks[np.argsort(-scores[peaks], kind="stable")]:
        lag = _vertex(curve.lags, scores, int(peak))
        if all(abs(lag - other) >= apart for other, _ in found):
            found.append((lag, float(scores[peak])))
            if len(found) == most:
                break
    return found


def _vertex(lags: Float64s, scores: Float64s, peak: int) -> float:
    """Where the parabola through a maximum and its two neighbours has its vertex."""
    if not 0 < peak < len(lags) - 1:
        return float(lags[peak])
    left, middle, right = scores[peak - 1 : peak + 2]
    bend = left - 2 * middle + right
    if not np.isfinite(bend) or bend >= 0:
        return float(lags[peak])
    shift = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
    return float(lags[peak] + shift * (lags[peak + 1] - lags[peak - 1]) / 2)
