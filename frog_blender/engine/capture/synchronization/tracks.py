"""Without cameras: points known by name in all films, as a person's joints are, and a fundamental matrix for each lag.

Only at the right lag does one geometry explain them all. One pair of films alone is often wrong, for a person who
walks repeats themselves and few poses fit a geometry at any lag: the sum over all pairs, of which only offsets that
close around every triangle have much, is far surer.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from ...arrays import Float64s, Ints
from ..epipolar import sampson_distances
from ..video import load_opencv
from . import limits
from .pairs import Curve, PairLag, maxima

_CONFIDENCE, _ROUNDS, _SEED = 0.999, 2000, 7  # of the fundamental matrix
_CLIMBS = 30


@dataclass(frozen=True, eq=False)
class NamedTracks:
    """Points that have the same names in all films.

    Attributes:
        times: (T,) float64 seconds in the film, ascending.
        positions: (T, P, 2) float64 pixels; NaN where a point is not seen.
    """

    times: Float64s
    positions: Float64s

    @property
    def interval(self) -> float:
        """Seconds between two times (the median); 0 for a single one."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0

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


def track_lags(tracks: Sequence[NamedTracks], width: int) -> list[PairLag]:
    """The lags of all pairs of films whose named points fit together; none where too few are seen by both.

    Args:
        tracks: of all films.
        width: pixels of the films.
    """
    frame = max(track.interval for track in tracks)
    pairs = list(combinations(range(len(tracks)), 2))
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # OpenCV computes outside Python's lock
        compared = list(threads.map(lambda pair: _curve(tracks[pair[0]], tracks[pair[1]], frame, width), pairs))
    curves = {pair: curve for pair, curve in zip(pairs, compared, strict=True) if np.isfinite(curve.scores).any()}
    if not curves:
        return []
    step = limits.TRACK_STEP * frame
    offsets = _agreed(curves, len(tracks), step) * step
    lags = []
    for (first, second), curve in curves.items():
        lag = float(offsets[second] - offsets[first])
        score = float(np.interp(lag, curve.lags, np.nan_to_num(curve.scores), left=0.0, right=0.0))
        if score > 0:
            middle = float(np.mean(tracks[second].times[[0, -1]]))
            lags.append(PairLag(first, second, lag, middle, limits.TRACK_SIGMA * frame, score, "tracks", curve=curve))
    return lags


def _curve(first: NamedTracks, second: NamedTracks, frame: float, width: int) -> Curve:
    """How well one geometry explains two films' points, over lags."""
    if min(len(first.times), len(second.times)) < 2:
        return Curve()
    least = limits.TRACK_OVERLAP * min(np.ptp(first.times), np.ptp(second.times))
    low, high = first.times[0] - second.times[-1] + least, first.times[-1] - second.times[0] - least
    step = limits.TRACK_STEP * frame
    lags = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    scores = [_score(first.at(second.times + lag, limits.TRACK_GAP * frame), second.positions, width) for lag in lags]
    padded = np.pad(scores, 1, mode="edge")
    # The median of three: one lucky draw is no peak.
    return Curve(lags, np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0))


def _score(first: Float64s, second: Float64s, width: int) -> float:
    """1 less the mean truncated squared Sampson residual in units of the truncation; NaN without a geometry."""
    cv2 = load_opencv()
    a, b = first.reshape(-1, 2), second.reshape(-1, 2)
    seen = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    if seen.sum() < limits.TRACK_POINTS:
        return float("nan")
    truncation = max(1.0, limits.TRACK_TRUNCATION * width)
    cv2.setRNGSeed(_SEED)
    matrix, _ = cv2.findFundamentalMat(a[seen], b[seen], cv2.USAC_MAGSAC, truncation, _CONFIDENCE, _ROUNDS)
    if matrix is None or matrix.shape[0] < 3:
        return float("nan")
    distances = sampson_distances(matrix[:3], a[seen], b[seen])
    return 1 - float(np.minimum((distances / truncation) ** 2, 1).mean())


def _agreed(curves: Mapping[tuple[int, int], Curve], count: int, step: float) -> Ints:
    """(C,) steps at which the films begin for the pairs' scores to sum up highest: no film's move betters them."""
    reach = max(round(float(np.abs(curve.lags).max()) / step) for curve in curves.values())
    middle = 4 * reach
    table = np.zeros((count, count, 2 * middle + 1))  # of each pair over lags, zero where the films share too little
    for (first, second), curve in curves.items():
        table[first, second, np.round(curve.lags / step).astype(int) + middle] = np.nan_to_num(curve.scores)
        table[second, first] = table[first, second, ::-1]
    wide = np.arange(-2 * reach, 2 * reach + 1)
    films = np.arange(count)
    best, most = np.zeros(count, dtype=np.int64), -np.inf
    for offsets in _starts(table, middle, step):
        for _ in range(_CLIMBS):
            before = offsets.copy()
            for film in films:
                others = np.flatnonzero(films != film)
                sums = table[others[:, None], film, wide - offsets[others, None] + middle].sum(axis=0)
                offsets[film] = wide[int(sums.argmax())]
            if (offsets == before).all():
                break
        total = float(table[films[:, None], films, offsets - offsets[:, None] + middle].sum())
        if total > most + 1e-9:
            best, most = offsets, total
    return best


def _starts(table: Float64s, middle: int, step: float) -> Iterator[Ints]:
    """All films placed by one of them, at the peaks of its pairs' curves."""
    count, lags = len(table), np.arange(-middle, middle + 1.0)
    most = max(1, min(limits.TRACK_PEAKS, int(limits.TRACK_STARTS ** (1 / max(count - 1, 1)) + 1e-9)))
    for root in range(count):
        peaks = [[round(lag) for lag, _ in maxima(Curve(lags, table[root, film]), 2, most)] for film in range(count)]
        peaks[root] = [0]
        for start in product(*peaks):
            yield np.array(start, dtype=np.int64).clip(-(middle // 2), middle // 2)
