"""Where films could begin, by a person's joints: the offsets at which every pair of films has one geometry.

One pair alone is often wrong: a person who walks repeats themselves, and few poses fit a geometry at any lag. The sum
over all pairs, which only offsets that close around every triangle can have, is much surer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..synchronization.lags import NamedTracks, track_lag
from ..synchronization.pair import Curve, maxima
from .joint_sides import other_side

_PEAKS = 4  # of a pair's curve, from which the search starts
_MOST_STARTS = 64  # for each film that the others are placed by
_APART = 2  # steps between two peaks
_ROUNDS = 30
_MOST_WAYS = 16  # in which the films' sides may be together
_STRIDE = 0.3  # seconds: a person who walks repeats themselves no sooner


@dataclass(frozen=True, eq=False)
class Guess:
    """What films may have in common.

    Attributes:
        offsets: (C,) seconds, the first film's 0.
        readings: (C,) which of its readings each film has.
        sides: (C,) films in which left is right in that reading.
        score: the sum over the pairs of films.
    """

    offsets: Float64s
    readings: Ints
    sides: Bools
    score: float


class _Pair(NamedTuple):
    """Two films, the reading of each, and whether left is right in one of them."""

    first: int
    second: int
    readings: tuple[int, int]
    is_crossed: bool


@dataclass(frozen=True)
class _Way:
    """(C,) which of its readings each film has, and in which of them left is right."""

    readings: tuple[int, ...]
    sides: tuple[bool, ...]

    def pair(self, first: int, second: int) -> _Pair:
        readings = self.readings[first], self.readings[second]
        return _Pair(first, second, readings, self.sides[first] != self.sides[second])


@dataclass(frozen=True, eq=False)
class _Scores:
    """(L,) scores of each pair over lags of -(L // 2) to L // 2 steps, 0 where the pair shows too little."""

    pairs: Mapping[tuple[int, int], Float64s]
    count: int
    reach: int

    def of(self, pair: tuple[int, int], lags: Ints | int) -> Float64s:
        places = np.asarray(lags) + self.reach
        scores = self.pairs[pair]
        found: Float64s = np.where(
            (places >= 0) & (places < len(scores)), scores[np.clip(places, 0, len(scores) - 1)], 0.0
        )
        return found

    def total(self, offsets: Ints) -> float:
        pairs = combinations(range(self.count), 2)
        return float(sum(self.of(pair, offsets[pair[1]] - offsets[pair[0]]) for pair in pairs))


def guesses(
    films: Sequence[Sequence[NamedTracks]], doubtful: Sequence[bool], interval: float, width: int, most: int
) -> list[Guess]:
    """The likeliest offsets, best first, and then what they may hide; none where no two films share enough.

    Args:
        films: a person's joints in each film, in pairs of left and right, in one or more readings.
        doubtful: films in which left may be right.
        interval: seconds between their times.
        width: pixels of the films' longer side.
        most: guesses that are wanted; they lie ``interval`` or more apart. As many again are the best one with one film
            moved to where it fits next best: a stride earlier or later.
    """
    ways = _ways([len(readings) for readings in films], doubtful)
    curves = _curves(films, ways, interval, width)
    steps = [float(np.diff(curve.lags).min()) for curve in curves.values() if len(curve.lags) > 1]
    if not steps:
        return []
    step = min(steps)
    found: dict[tuple[tuple[int, ...], _Way], float] = {}
    for way in ways:
        scores = _scores(curves, way, step)
        for offsets in _climbed(scores):
            found[tuple((offsets - offsets[0]).tolist()), way] = scores.total(offsets)
    chosen = _apart(found, [], step, interval, most)
    if not chosen:
        return []
    (best, way), _ = max(found.items(), key=lambda entry: entry[1])
    scores = _scores(curves, way, step)
    moved = {
        (tuple((offsets - offsets[0]).tolist()), way): scores.total(offsets)
        for offsets in _strides(scores, np.array(best), step)
    }
    return [*chosen, *_apart(moved, chosen, step, interval, most)]


def _apart(
    found: Mapping[tuple[tuple[int, ...], _Way], float],
    others: Sequence[Guess],
    step: float,
    interval: float,
    most: int,
) -> list[Guess]:
    """The best of what was found, each ``interval`` or more from the better ones and from others."""
    chosen: list[Guess] = []
    for (steps_apart, way), score in sorted(found.items(), key=lambda entry: -entry[1]):
        guess = Guess(np.array(steps_apart) * step, np.array(way.readings), np.array(way.sides), score)
        if all(np.ptp(guess.offsets - other.offsets) >= interval for other in (*others, *chosen)):
            chosen.append(guess)
            if len(chosen) == most:
                break
    return chosen


def _strides(scores: _Scores, offsets: Ints, step: float) -> Iterator[Ints]:
    """One film moved to where it fits the others next best."""
    wide = np.arange(-2 * scores.reach, 2 * scores.reach + 1)
    for film in range(scores.count):
        sums = np.zeros(len(wide))
        for other in range(scores.count):
            if other != film:
                sums += scores.of((other, film), wide - offsets[other])
        for place, _ in maxima(Curve(wide * step, sums), _STRIDE):
            moved = offsets.copy()
            moved[film] = round(place / step)
            if abs(moved[film] - offsets[film]) * step >= _STRIDE:
                yield moved


def _ways(readings: Sequence[int], doubtful: Sequence[bool]) -> list[_Way]:
    """How the films may be read together; left for right in all of them at once is the same as in none."""
    options, count = [], 1
    for film, (number, may) in enumerate(zip(readings, doubtful, strict=True)):
        is_turned = may and not (film == 0 and all(doubtful))
        own = list(product(range(number), (False, True) if is_turned else (False,)))
        if count * len(own) > _MOST_WAYS:
            own = own[:1]
        options.append(own)
        count *= len(own)
    return [
        _Way(tuple(reading for reading, _ in chosen), tuple(side for _, side in chosen)) for chosen in product(*options)
    ]


def _curves(
    films: Sequence[Sequence[NamedTracks]], ways: Sequence[_Way], interval: float, width: int
) -> dict[_Pair, Curve]:
    """Each pair's curve, in each of its readings and with left for right in one of its films, where that may be."""
    found: dict[_Pair, Curve] = {}
    pairs = combinations(range(len(films)), 2)
    for pair in dict.fromkeys(way.pair(first, second) for first, second in pairs for way in ways):
        track, other = films[pair.first][pair.readings[0]], films[pair.second][pair.readings[1]]
        if pair.is_crossed:
            other = replace(other, positions=other.positions[:, other_side(other.positions.shape[1])])
        lag = track_lag((pair.first, pair.second), (track, other), interval, width)
        if lag is not None:
            found[pair] = lag.curve
    return found


def _scores(curves: Mapping[_Pair, Curve], way: _Way, step: float) -> _Scores:
    reach = max(round(float(np.abs(curve.lags).max()) / step) for curve in curves.values())
    count = len(way.sides)
    pairs = {(one, other): np.zeros(2 * reach + 1) for one, other in product(range(count), repeat=2)}
    for first, second in combinations(range(count), 2):
        curve = curves.get(way.pair(first, second))
        if curve is not None:
            places = np.round(curve.lags / step).astype(int) + reach
            pairs[first, second][places] = np.nan_to_num(curve.scores, nan=0.0)
            pairs[second, first] = pairs[first, second][::-1]
    return _Scores(pairs, count, reach)


def _climbed(scores: _Scores) -> Iterator[Ints]:
    """Offsets that no single film's move betters, from many starts."""
    wide = np.arange(-2 * scores.reach, 2 * scores.reach + 1)
    for start in _starts(scores):
        offsets = start
        for _ in range(_ROUNDS):
            before = scores.total(offsets)
            for film in range(scores.count):
                sums = sum(
                    scores.of((other, film), wide - offsets[other]) for other in range(scores.count) if other != film
                )
                moved = offsets.copy()
                moved[film] = wide[int(np.argmax(sums))]
                offsets = moved
            if scores.total(offsets) <= before + 1e-9:
                break
        yield offsets


def _starts(scores: _Scores) -> Iterator[Ints]:
    """All films placed by one of them, at the peaks of its pairs' curves."""
    most = max(1, min(_PEAKS, int(_MOST_STARTS ** (1 / max(scores.count - 1, 1)) + 1e-9)))
    for root in range(scores.count):
        places = [
            [0] if film == root else _peaks(scores.pairs[root, film], most, scores.reach)
            for film in range(scores.count)
        ]
        for start in product(*places):
            yield np.array(start)


def _peaks(curve: Float64s, most: int, reach: int) -> list[int]:
    """The highest places of a curve, in steps of lag; 0 where it has none."""
    found: list[int] = []
    for place in np.argsort(-curve, kind="stable").tolist():
        if curve[place] <= 0 or len(found) == most:
            break
        if all(abs(place - reach - other) > _APART for other in found):
            found.append(place - reach)
    return found or [0]
