"""What one source says about two films, and from that one offset and rate a camera: the answer most pairs agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...arrays import Bools, Float64s
from . import limits

_ROUNDS = 40  # of reweighting

Source = Literal["audio", "energy", "motion"]
"""``motion``: epipolar residuals of moving points, the finest."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A score over lags, for a person to look at.

    Attributes:
        lags: (L,) float64 seconds, ascending.
        scores: (L,) float64; the greater the better, NaN where nothing could be compared.
    """

    lags: Float64s = field(default_factory=lambda: np.zeros(0))
    scores: Float64s = field(default_factory=lambda: np.zeros(0))

    @property
    def known(self) -> Curve:
        """The part of it where something could be compared."""
        known = np.isfinite(self.scores)
        return Curve(self.lags[known], self.scores[known])


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
    curve: Curve = field(default_factory=Curve)

    @property
    def rivals(self) -> tuple[float, ...]:
        """Lags whose score comes within a tenth of the best."""
        return tuple(lag for lag, score in self.others if score >= limits.RIVAL * self.score)


def maxima(curve: Curve, apart: float, most: int = 4) -> list[tuple[float, float]]:
    """The highest local maxima (lag, score) of a curve, best first, at least ``apart`` seconds from each other.

    Peaks lie between samples where a parabola through three of them says so.
    """
    scores = np.where(np.isfinite(curve.scores), curve.scores, -np.inf)
    padded = np.concatenate([[-np.inf], scores, [-np.inf]])
    peaks = np.flatnonzero((scores >= padded[:-2]) & (scores >= padded[2:]) & np.isfinite(scores))
    chosen: list[tuple[float, float]] = []
    for peak in peaks[np.argsort(-scores[peaks], kind="stable")]:
        lag = vertex(curve.lags, scores, int(peak))
        if len(chosen) < most and all(abs(lag - other) >= apart for other, _ in chosen):
            chosen.append((lag, float(scores[peak])))
    return chosen


def vertex(lags: Float64s, scores: Float64s, peak: int) -> float:
    """Where the parabola through a maximum and its two neighbours has its vertex."""
    if not 0 < peak < len(lags) - 1:
        return float(lags[peak])
    left, middle, right = scores[peak - 1 : peak + 2]
    bend = left - 2 * middle + right
    if not np.isfinite(bend) or bend >= 0:
        return float(lags[peak])
    shift = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
    return float(lags[peak] + shift * (lags[peak + 1] - lags[peak - 1]) / 2)


@dataclass(frozen=True, eq=False)
class Timing:
    """Every film's clock: capture time = offset + rate * film time.

    Attributes:
        offsets: (C,) float64 seconds.
        rates: (C,) float64 seconds of capture time for each second of film.
    """

    offsets: Float64s
    rates: Float64s

    def lag(self, first: int, second: int, at: float) -> float:
        """Seconds by which the first film's time is ahead of the second's ``at``, at the same instant."""
        return self.film_time(first, self.capture_time(second, at)) - at

    def capture_time(self, film: int, time: float) -> float:
        return float(self.offsets[film] + self.rates[film] * time)

    def film_time(self, film: int, time: float) -> float:
        """Seconds in a film at a capture time."""
        return float((time - self.offsets[film]) / self.rates[film])


@dataclass(frozen=True, eq=False)
class Solution:
    """The clocks, and how the pairs bear them out.

    Attributes:
        clocks: of all films.
        misses: (P,) float64 seconds by which each pair's lag misses the clocks.
        support: (C,) share of the weight of a film's pairs that agree within half a frame.
        connected: (C,) films that any pair reaches from the reference.
        open_triangles: share of the triangles of pairs through each film that do not close within half a frame; NaN
            where a film is in none.
    """

    clocks: Timing
    misses: Float64s
    support: Float64s
    connected: Bools
    open_triangles: Float64s


@dataclass(frozen=True, eq=False)
class _Links:
    """Pairs as equations: ``matrix @ offsets`` is one of ``candidates`` (P, K), NaN-padded.

    ``matrix`` (P, C) has 1 for the second film and -1 for the first; ``sigmas`` (P,) are in the unit of the candidates;
    ``weights`` (P,) are the share of trust over the sigma.
    """

    matrix: Float64s
    candidates: Float64s
    weights: Float64s
    sigmas: Float64s

    @property
    def own(self) -> Bools:
        """(P, C) which films a pair joins."""
        return np.asarray(self.matrix != 0)

    def nearest(self, offsets: Float64s) -> Float64s:
        """(P,) each pair's candidate that fits the offsets best."""
        missed = np.abs(self.candidates - (self.matrix @ offsets)[:, None])
        chosen = np.where(np.isfinite(missed), missed, np.inf).argmin(axis=1)
        return np.asarray(self.candidates[np.arange(len(chosen)), chosen])


def _linked(
    count: int, pairs: Sequence[PairLag], lags: Sequence[Sequence[float]], weights: Float64s, sigmas: Float64s
) -> _Links:
    """The equations of pairs with their candidates."""
    rows, matrix = np.arange(len(pairs)), np.zeros((len(pairs), count))
    matrix[rows, [pair.second for pair in pairs]] += 1
    matrix[rows, [pair.first for pair in pairs]] -= 1
    candidates = np.full((len(pairs), max((len(row) for row in lags), default=1)), np.nan)
    for row, values in zip(candidates, lags, strict=True):
        row[: len(values)] = values
    return _Links(matrix, candidates, weights, sigmas)


def solve(count: int, pairs: Sequence[PairLag], frame: float, length: float) -> Solution:
    """The clocks of ``count`` films.

    Among rivals of like score the smallest lag comes first, for motion repeats itself.

    Args:
        pairs: lags; several of a pair may stand beside each other.
        frame: seconds between frames.
        length: seconds of the longest film.
    """
    rates = _rates(count, pairs, frame, length)
    lags = []
    for pair in pairs:
        one, other = rates[pair.first], rates[pair.second]
        candidates = sorted([pair.lag, *pair.rivals], key=abs)
        lags.append([one * (pair.at + lag) - other * pair.at for lag in candidates])
    sigmas = np.array([max(pair.sigma, limits.FINEST * frame) for pair in pairs])
    links = _linked(count, pairs, lags, np.array([pair.score for pair in pairs]) / sigmas, sigmas)
    offsets = _offsets(links, frame)
    offsets = offsets - offsets.min()
    chosen = links.nearest(offsets)
    misses = chosen - links.matrix @ offsets
    weights = links.own * links.weights[:, None]
    agreeing = weights[np.abs(misses) < limits.CLOSES * frame].sum(axis=0)
    support = np.where(agreeing > 0, agreeing / np.maximum(weights.sum(axis=0), 1e-300), 0.0)
    triangles = _open_triangles(count, pairs, chosen, links.weights, frame)
    connected = _spanning(links, int(links.own.sum(axis=0).argmax()))[1] & bool(pairs)
    return Solution(Timing(offsets, rates), misses, support, connected, triangles)


def _rates(count: int, pairs: Sequence[PairLag], frame: float, length: float) -> Float64s:
    """(C,) rates; 1 wherever no difference between clocks was measured beyond doubt."""
    measured = [pair for pair in pairs if np.isfinite(pair.rate_sigma)]
    if not measured:
        return np.ones(count)
    sigmas = np.array([max(pair.rate_sigma, 1e-7) for pair in measured])
    logarithms = [[float(np.log(pair.rate))] for pair in measured]
    links = _linked(count, measured, logarithms, 1 / sigmas, sigmas)
    rates = _offsets(links, float(np.median(sigmas)) / limits.FINEST)
    rates = rates - rates[np.abs(rates[:, None] - rates).sum(axis=1).argmin()]  # the clock that agrees best is right
    doubt = limits.RATE_SIGNIFICANT / np.sqrt(np.maximum((links.own * links.weights[:, None] ** 2).sum(axis=0), 1e-300))
    is_measured = (np.abs(rates) >= doubt) & (np.abs(rates) * length >= limits.RATE_VISIBLE * frame)
    return np.asarray(np.exp(np.where(is_measured, rates, 0.0)))


def _offsets(links: _Links, frame: float) -> Float64s:
    """(C,) offsets of least robust cost, from as many starts as there are films; the smaller spread of equals."""
    count = links.matrix.shape[1]
    best, least = np.zeros(count), np.inf
    for root in range(count if len(links.matrix) else 0):
        offsets, _ = _spanning(links, root)
        for _ in range(8):
            before, offsets = offsets, _least_misses(links, links.nearest(offsets), offsets, frame)
            if np.abs(offsets - before).max() < 1e-4 * frame:
                break
        missed = np.minimum(np.abs(links.nearest(offsets) - links.matrix @ offsets), limits.LOST * frame)
        spread = float(np.abs(offsets - np.median(offsets)).sum())
        cost = float((links.weights * missed).sum()) + 1e-3 * spread * float(links.weights.mean())
        if cost < least - 1e-12:
            best, least = offsets, cost
    return best


def _spanning(links: _Links, root: int) -> tuple[Float64s, Bools]:
    """(C,) offsets along the tree of the heaviest pairs that grows from one film, by first candidates, and the films
    that it reaches."""
    offsets, reached = np.zeros(len(links.matrix.T)), np.arange(len(links.matrix.T)) == root
    while (leaves := (links.own & reached).sum(axis=1) == 1).any():
        link = int(np.where(leaves, links.weights, -1).argmax())
        film = int(np.flatnonzero(links.own[link] & ~reached)[0])
        # What has not been reached is at 0 and adds nothing.
        offsets[film] = (links.candidates[link, 0] - links.matrix[link] @ offsets) * links.matrix[link, film]
        reached[film] = True
    return offsets, reached


def _least_misses(links: _Links, lags: Float64s, start: Float64s, frame: float) -> Float64s:
    """(C,) offsets of least weighted absolute misses, those within a sigma squared (Huber), by reweighting."""
    offsets = start.copy()
    # Films that no pair reaches stay where they are.
    anchor = 1e-6 * float(links.weights.mean()) / frame
    # Nothing tells where capture time starts: the first film stays.
    side, free = lags - links.matrix[:, 0] * start[0], links.matrix[:, 1:]
    for turn in range(_ROUNDS):
        smallest = np.maximum(links.sigmas, frame * 0.5**turn)
        weights = links.weights / np.maximum(np.abs(lags - links.matrix @ offsets), smallest)
        normal = free.T @ (weights[:, None] * free) + anchor * np.eye(len(free.T))
        offsets[1:] = np.linalg.solve(normal, free.T @ (weights * side) + anchor * offsets[1:])
    return offsets


def _open_triangles(count: int, pairs: Sequence[PairLag], lags: Float64s, weights: Float64s, frame: float) -> Float64s:
    """(C,) weighted share of the triangles of pairs through a film whose lags do not add up; NaN in none."""
    lag, weight = np.full((count, count), np.nan), np.zeros((count, count))
    for pair, value, heavy in zip(pairs, lags, weights, strict=True):
        first, second = pair.first, pair.second
        if heavy > weight[first, second]:
            lag[first, second], lag[second, first] = value, -value
            weight[first, second] = weight[second, first] = heavy
    around = lag[:, :, None] + lag + lag.T[:, None]  # film -> b -> c -> film
    heavy = np.minimum(np.minimum(weight[:, :, None], weight), weight.T[:, None])
    heavy[np.isnan(around)] = 0
    total, is_open = heavy.sum(axis=(1, 2)), np.abs(around) > limits.CLOSES * frame
    return np.where(total > 0, (heavy * is_open).sum(axis=(1, 2)) / np.maximum(total, 1e-300), np.nan)
