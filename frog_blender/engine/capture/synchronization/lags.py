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
_LEAST_OVERLAP = 0.25  # of the shorter film
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
    pair: tuple[int, int], tracks: tuple[NamedTracks, NamedTracks], frame: float, width: int
) -> PairLag | None:
    """The lag at which one fundamental matrix explains most named points; None where too few are seen by both.

    Args:
        pair: indices of the films.
        tracks: of the two films.
        frame: seconds between frames.
        width: pixels of the films.
    """
    first, second = tracks
    if min(len(first.times), len(second.times)) < 2:
        return None
    least = _LEAST_OVERLAP * min(np.ptp(first.times), np.ptp(second.times))
    low, high = first.times[0] - second.times[-1] + least, first.times[-1] - second.times[0] - least
    step = _STEP * frame
    lags = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    scores = np.array([_score(tracks, float(lag), frame, width) for lag in lags])
    curve = Curve(lags, _smoothed(scores))
    found = maxima(curve, 2 * frame)
    if not found or found[0][1] <= 0:
        return None
    lag, score = found[0]
    return PairLag(
        first=pair[0],
        second=pair[1],
        lag=lag,
        at=float((max(second.times[0], first.times[0] - lag) + min(second.times[-1], first.times[-1] - lag)) / 2),
        sigma=0.3 * frame,
        score=score,
        source="tracks",
        others=tuple(found[1:]),
        curve=curve,
    )


def _score(tracks: tuple[NamedTracks, NamedTracks], lag: float, frame: float, width: int) -> float:
    """1 less the mean truncated squared Sampson residual in units of the truncation; NaN with too few points."""
    cv2 = load_opencv()
    first, second = tracks
    times = second.times
    a, b = first.at(times + lag, _GAP * frame).reshape(-1, 2), second.positions.reshape(-1, 2)
    seen = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    if seen.sum() < _LEAST:
        return float("nan")
    a, b = a[seen], b[seen]
    truncation = max(1.0, _TRUNCATION * width)
    cv2.setRNGSeed(_SEED)
    matrix: Array | None
    matrix, _ = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, truncation, _CONFIDENCE, _ROUNDS)
    if matrix is None or matrix.shape[0] < 3:
        return float("nan")
    residuals = signed_residuals(matrix[:3], a, b)
    return 1 - float(np.minimum((residuals / truncation) ** 2, 1).mean())


def _smoothed(scores: Float64s) -> Float64s:
    """The median of three: one lucky draw is no peak."""
    padded = np.pad(scores, 1, mode="edge")
    result: Float64s = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    return result
