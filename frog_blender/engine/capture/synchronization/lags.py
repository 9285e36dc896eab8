"""Without cameras: points known by name in both films, such as joints, and a fundamental matrix for every lag.

Only at the right lag does one geometry explain them all. Nothing else need be known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array, Float64s
from ..video import load_opencv
from .epipolar import signed_residuals
from .pair import Curve, PairLag, maxima

_STEP = 0.25  # frames
_LEAST_OVERLAP = 0.5  # of the shorter film: one geometry fits a few poses at any lag
_LEAST = 30  # points seen by both
_TRUNCATION = 0.012  # of the width: named points are uncertain by so much
_CONFIDENCE, _ROUNDS = 0.999, 2000
_GAP = 1.5  # frames between which a position may be interpolated
_SEED = 7


@dataclass(frozen=True, eq=False)
class NamedTracks:
    """Points that have the same names in all films.

    Attributes:
        times: (T,) float64 seconds in the film, ascending.
        positions: (T, P, 2) float64 pixels; NaN where a point is not seen.
    """

    times: Float64s
    positions: Float64s

    def at(self, times: Float64s, gap: float) -> Float64s:
        """(M, P, 2) positions at film times (M,), NaN beyond the film and in gaps of more than ``gap`` seconds."""
        after = np.searchsorted(self.times, times, side="left").clip(1, len(self.times) - 1)
        before = after - 1
        length = self.times[after] - self.times[before]
        share = ((times - self.times[before]) / np.maximum(length, 1e-12))[:, None, None]
        result: Float64s = (1 - share) * self.positions[before] + share * self.positions[after]
        outside = (share[:, 0, 0] < -1e-9) | (share[:, 0, 0] > 1 + 1e-9) | (length > gap)
        result[outside] = np.nan
        return result


def track_lag(
    pair: tuple[int, int],
    tracks: tuple[NamedTracks, NamedTracks],
    frame: float,
    width: int,
    matrix: Float64s | None = None,
) -> PairLag | None:
    """The lag at which one fundamental matrix explains most named points; None where too few are seen by both.

    Args:
        pair: indices of the films.
        tracks: of the two films.
        frame: seconds between frames.
        width: pixels of the films.
        matrix: (3, 3) fundamental matrix where the cameras are known; else every lag gets the one that suits it best.
    """
    first, second = tracks
    if min(len(first.times), len(second.times)) < 2:
        return None
    least = _LEAST_OVERLAP * min(np.ptp(first.times), np.ptp(second.times))
    low, high = first.times[0] - second.times[-1] + least, first.times[-1] - second.times[0] - least
    step = _STEP * frame
    lags = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    scores = np.full(len(lags), np.nan)
    for position, lag in enumerate(lags):
        seen = _seen(tracks, float(lag), frame)
        scores[position] = np.nan if seen is None else _score(seen, width, matrix)
    curve = Curve(lags, _smoothed(scores) if matrix is None else scores)
    found = maxima(curve, 2 * frame)
    if not found or found[0][1] <= 0:
        return None
    lag, score = found[0]
    return PairLag(
        first=pair[0],
        second=pair[1],
        lag=lag,
        at=float((max(second.times[0], first.times[0] - lag) + min(second.times[-1], first.times[-1] - lag)) / 2),
        sigma=(0.3 if matrix is None else 0.15) * frame,
        score=score,
        source="tracks",
        others=tuple(found[1:]),
        curve=curve,
    )


def _seen(tracks: tuple[NamedTracks, NamedTracks], lag: float, frame: float) -> tuple[Float64s, Float64s] | None:
    """Positions (M, 2) in both films at a lag, seconds; None with too few."""
    first, second = tracks
    a, b = first.at(second.times + lag, _GAP * frame).reshape(-1, 2), second.positions.reshape(-1, 2)
    seen = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    return (a[seen], b[seen]) if seen.sum() >= _LEAST else None


def _score(seen: tuple[Float64s, Float64s], width: int, known: Float64s | None) -> float:
    """1 less the mean truncated squared Sampson residual in units of the truncation; NaN without a geometry."""
    cv2 = load_opencv()
    truncation = max(1.0, _TRUNCATION * width)
    matrix: Array | None = known
    if matrix is None:
        cv2.setRNGSeed(_SEED)
        matrix, _ = cv2.findFundamentalMat(*seen, cv2.USAC_MAGSAC, truncation, _CONFIDENCE, _ROUNDS)
    if matrix is None or matrix.shape[0] < 3:
        return float("nan")
    residuals = signed_residuals(matrix[:3], *seen)
    if known is not None:
        residuals = _without_bias(residuals, seen[0], truncation, width)
    return 1 - float(np.minimum((residuals / truncation) ** 2, 1).mean())


def _without_bias(residuals: Float64s, places: Float64s, truncation: float, width: int) -> Float64s:
    """(M,) residuals less what is constant and rises across the image: a detector sees joints beside where they are."""
    columns = np.column_stack([np.ones(len(places)), (places - places.mean(axis=0)) / width])
    left = residuals
    for _ in range(3):
        weights = 1 / (1 + (left / truncation) ** 2)
        normal = columns.T @ (weights[:, None] * columns) + 1e-6 * len(places) * np.eye(3)
        left = residuals - columns @ np.linalg.solve(normal, columns.T @ (weights * residuals))
    return left


def _smoothed(scores: Float64s) -> Float64s:
    """The median of three: one lucky draw is no peak."""
    padded = np.pad(scores, 1, mode="edge")
    result: Float64s = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    return result
