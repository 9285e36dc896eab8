"""From lags between pairs of films to one offset and rate a camera: the robust answer that most pairs agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Bools, Float64s, Ints
from .pair import PairLag

_FINEST = 0.02  # frames: no pair weighs more than one of this standard deviation
_CLOSES = 0.5  # frames by which a pair may miss the answer, and a triangle may fail to close
_LOST = 3.0  # frames beyond which a pair that misses costs no more
_ROUNDS = 40
_SIGNIFICANT = 3.0  # standard deviations by which a rate must differ from 1
_VISIBLE = 0.02  # frames that a rate must be worth at the end of a film


@dataclass(frozen=True, eq=False)
class Clocks:
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

    def of(self, films: Sequence[int]) -> Clocks:
        """Those of some films."""
        return Clocks(self.offsets[list(films)], self.rates[list(films)])

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

    clocks: Clocks
    misses: Float64s
    support: Float64s
    connected: Bools
    open_triangles: Float64s


@dataclass(frozen=True, eq=False)
class _Links:
    """Pairs as equations: offset of ``second`` less that of ``first`` is one of ``candidates`` (P, K), NaN-padded.

    ``sigmas`` (P,) are in the unit of the candidates; ``weights`` (P,) are the share of trust over the sigma.
    """

    first: Ints
    second: Ints
    candidates: Float64s
    weights: Float64s
    sigmas: Float64s


def solve(count: int, pairs: Sequence[PairLag], frame: float, length: float) -> Solution:
    """The clocks of ``count`` films.

    Args:
        pairs: lags; several of a pair may stand beside each other.
        frame: seconds between frames.
        length: seconds of the longest film.
    """
    rates = _rates(count, pairs, frame, length)
    links = _links(pairs, rates, frame)
    offsets = _offsets(count, links, frame)
    offsets = offsets - offsets.min()
    clocks = Clocks(offsets, rates)
    chosen = _nearest(links, offsets) if len(pairs) else np.zeros(0)
    links = replace(links, candidates=chosen[:, None])
    misses = chosen - _differences(links, offsets)
    agrees = np.abs(misses) < _CLOSES * frame
    support = np.array([_support(film, links, agrees) for film in range(count)])
    return Solution(clocks, misses, support, _connected(count, links), _open_triangles(count, links, frame))


def _rates(count: int, pairs: Sequence[PairLag], frame: float, length: float) -> Float64s:
    """(C,) rates; 1 wherever no difference between clocks was measured beyond doubt."""
    measured = [pair for pair in pairs if np.isfinite(pair.rate_sigma)]
    if not measured:
        return np.ones(count)
    sigmas = np.array([max(pair.rate_sigma, 1e-7) for pair in measured])
    links = _Links(
        np.array([pair.first for pair in measured]),
        np.array([pair.second for pair in measured]),
        np.log([[pair.rate] for pair in measured]),
        1 / sigmas,
        sigmas,
    )
    scale = float(np.median(sigmas))
    rates = _offsets(count, links, scale / _FINEST)
    rates = rates - rates[np.abs(rates[:, None] - rates).sum(axis=1).argmin()]  # the clock that agrees best is right
    for film in range(count):
        own = (links.first == film) | (links.second == film)
        sigma = float(np.sqrt(1 / (links.weights[own] ** 2).sum())) if own.any() else np.inf
        if abs(rates[film]) < _SIGNIFICANT * sigma or abs(rates[film]) * length < _VISIBLE * frame:
            rates[film] = 0.0
    result: Float64s = np.exp(rates)
    return result


def _links(pairs: Sequence[PairLag], rates: Float64s, frame: float) -> _Links:
    """Equations between offsets; among rivals of like score the smallest lag comes first, for motion repeats itself."""
    rows = []
    for pair in pairs:
        lags = sorted([pair.lag, *pair.rivals], key=abs)
        rows.append([rates[pair.first] * (pair.at + lag) - rates[pair.second] * pair.at for lag in lags])
    width = max((len(row) for row in rows), default=1)
    padded = np.array([row + [np.nan] * (width - len(row)) for row in rows]).reshape(len(rows), width)
    sigmas = np.array([max(pair.sigma, _FINEST * frame) for pair in pairs])
    return _Links(
        np.array([pair.first for pair in pairs], dtype=np.int64),
        np.array([pair.second for pair in pairs], dtype=np.int64),
        padded,
        np.array([pair.score for pair in pairs]) / sigmas,
        sigmas,
    )


def _offsets(count: int, links: _Links, frame: float) -> Float64s:
    """(C,) offsets of least robust cost, from as many starts as there are films; the smaller spread of equals."""
    if not len(links.first):
        return np.zeros(count)
    best, least = np.zeros(count), np.inf
    for root in range(count):
        offsets = _spanning(count, links, root)
        for _ in range(8):
            wanted = _nearest(links, offsets)
            improved = _least_misses(count, links, wanted, offsets, frame)
            settled = np.abs(improved - offsets).max() < 1e-4 * frame
            offsets = improved
            if settled:
                break
        missed = np.minimum(np.abs(_nearest(links, offsets) - _differences(links, offsets)), _LOST * frame)
        spread = float(np.abs(offsets - np.median(offsets)).sum())
        cost = float((links.weights * missed).sum()) + 1e-3 * spread * float(links.weights.mean())
        if cost < least - 1e-12:
            best, least = offsets, cost
    return best


def _differences(links: _Links, offsets: Float64s) -> Float64s:
    result: Float64s = offsets[links.second] - offsets[links.first]
    return result


def _nearest(links: _Links, offsets: Float64s) -> Float64s:
    """(P,) each pair's candidate that fits the offsets best."""
    missed = np.abs(links.candidates - _differences(links, offsets)[:, None])
    chosen = np.where(np.isfinite(missed), missed, np.inf).argmin(axis=1)
    result: Float64s = links.candidates[np.arange(len(chosen)), chosen]
    return result


def _spanning(count: int, links: _Links, root: int) -> Float64s:
    """(C,) offsets along the tree of the heaviest pairs that grows from one film; first candidates."""
    offsets, reached = np.zeros(count), np.zeros(count, dtype=bool)
    reached[root] = True
    while True:
        leaves = reached[links.first] != reached[links.second]
        if not leaves.any():
            return offsets
        link = int(np.where(leaves, links.weights, -1).argmax())
        first, second = links.first[link], links.second[link]
        if reached[first]:
            offsets[second] = offsets[first] + links.candidates[link, 0]
        else:
            offsets[first] = offsets[second] - links.candidates[link, 0]
        reached[first] = reached[second] = True


def _least_misses(count: int, links: _Links, wanted: Float64s, start: Float64s, frame: float) -> Float64s:
    """(C,) offsets of least weighted absolute misses, those within a sigma squared (Huber), by reweighting."""
    rows = np.arange(len(wanted))
    matrix = np.zeros((len(wanted), count))
    matrix[rows, links.second] += 1
    matrix[rows, links.first] -= 1
    offsets = start.copy()
    if count < 2:
        return offsets
    # Films that no pair reaches stay where they are.
    anchor = 1e-6 * float(links.weights.mean()) / frame
    for turn in range(_ROUNDS):
        smallest = np.maximum(links.sigmas, frame * 0.5**turn)
        weights = links.weights / np.maximum(np.abs(wanted - matrix @ offsets), smallest)
        # Nothing tells where capture time starts: the first film stays.
        side, free = wanted - matrix[:, 0] * start[0], matrix[:, 1:]
        normal = free.T @ (weights[:, None] * free) + anchor * np.eye(count - 1)
        offsets[1:] = np.linalg.solve(normal, free.T @ (weights * side) + anchor * offsets[1:])
    return offsets


def _support(film: int, links: _Links, agrees: Bools) -> float:
    own = (links.first == film) | (links.second == film)
    weight = float(links.weights[own].sum())
    return float(links.weights[own & agrees].sum()) / weight if weight > 0 else 0.0


def _connected(count: int, links: _Links) -> Bools:
    """Which films a chain of pairs joins to the film with most of them."""
    reached = np.zeros(count, dtype=bool)
    if not len(links.first):
        return reached
    reached[int(np.bincount(np.concatenate([links.first, links.second]), minlength=count).argmax())] = True
    for _ in range(count):
        touched = reached[links.first] | reached[links.second]
        reached[links.first[touched]] = reached[links.second[touched]] = True
    return reached


def _open_triangles(count: int, links: _Links, frame: float) -> Float64s:
    """(C,) weighted share of the triangles of pairs through a film whose lags do not add up; NaN in none."""
    lag, weight = np.full((count, count), np.nan), np.zeros((count, count))
    for first, second, value, heavy in zip(
        links.first, links.second, links.candidates[:, 0], links.weights, strict=True
    ):
        if heavy > weight[first, second]:
            lag[first, second], lag[second, first] = value, -value
            weight[first, second] = weight[second, first] = heavy
    shares = np.full(count, np.nan)
    for film in range(count):
        around = lag[film][:, None] + lag + lag[:, film][None]  # film -> b -> c -> film
        known = np.isfinite(around)
        heavy = np.minimum(np.minimum(weight[film][:, None], weight), weight[:, film][None])
        if known.any() and heavy[known].sum() > 0:
            is_open = np.abs(around) > _CLOSES * frame
            shares[film] = float(heavy[known & is_open].sum() / heavy[known].sum())
    return shares
