"""Where films could begin, by a person's joints: the offsets at which every pair of films has one geometry.

One pair alone is often wrong: a person who walks repeats themselves, and few poses fit a geometry at any lag. The sum
over all pairs, which only offsets that close around every triangle can have, is much surer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from ...arrays import Bools, Float64s, Ints
from ..synchronization.lags import NamedTracks, track_lag
from ..synchronization.pair import Curve
from .joint_sides import other_side

_PEAKS = 4  # of a pair's curve, from which the search starts
_MOST_STARTS = 64  # for each film that the others are placed by
_APART = 2  # steps between two peaks
_ROUNDS = 30
_MOST_DOUBTFUL = 3  # films whose sides are tried both ways


@dataclass(frozen=True, eq=False)
class Guess:
    """What films may have in common.

    Attributes:
        offsets: (C,) seconds, the first film's 0.
        sides: (C,) films in which left is right.
        score: the sum over the pairs of films.
    """

    offsets: Float64s
    sides: Bools
    score: float


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
    tracks: Sequence[NamedTracks], doubtful: Sequence[bool], interval: float, width: int, most: int
) -> list[Guess]:
    """The likeliest offsets, best first; none where no two films share enough.

    Args:
        tracks: a person's joints in each film, in pairs of left and right.
        doubtful: films in which left may be right.
        interval: seconds between their times.
        width: pixels of the films' longer side.
        most: guesses that are wanted; they lie ``interval`` or more apart.
    """
    curves = _curves(tracks, doubtful, interval, width)
    steps = [float(np.diff(curve.lags).min()) for curve in curves.values() if len(curve.lags) > 1]
    if not steps:
        return []
    found: dict[tuple[tuple[int, ...], tuple[bool, ...]], float] = {}
    for sides in _sides(doubtful):
        scores = _scores(curves, sides, min(steps))
        for offsets in _climbed(scores):
            found[tuple((offsets - offsets[0]).tolist()), sides] = scores.total(offsets)
    chosen: list[Guess] = []
    for (steps_apart, sides), score in sorted(found.items(), key=lambda entry: -entry[1]):
        guess = Guess(np.array(steps_apart) * min(steps), np.array(sides), score)
        if all(np.ptp(guess.offsets - other.offsets) >= interval for other in chosen):
            chosen.append(guess)
            if len(chosen) == most:
                break
    return chosen


def _curves(
    tracks: Sequence[NamedTracks], doubtful: Sequence[bool], interval: float, width: int
) -> dict[tuple[int, int, bool], Curve]:
    """Each pair's curve, and that with left for right in one of its films where that may be."""
    found = {}
    for first, second in combinations(range(len(tracks)), 2):
        for is_crossed in (False, True) if doubtful[first] or doubtful[second] else (False,):
            other = tracks[second]
            if is_crossed:
                other = replace(other, positions=other.positions[:, other_side(other.positions.shape[1])])
            lag = track_lag((first, second), (tracks[first], other), interval, width)
            if lag is not None:
                found[first, second, is_crossed] = lag.curve
    return found


def _sides(doubtful: Sequence[bool]) -> Iterator[tuple[bool, ...]]:
    """Which films may have changed left for right; all films at once is the same as none."""
    open_ = [film for film, may in enumerate(doubtful) if may]
    open_ = open_[len(open_) == len(doubtful) :][:_MOST_DOUBTFUL]
    for chosen in product((False, True), repeat=len(open_)):
        changed = {film for film, is_changed in zip(open_, chosen, strict=True) if is_changed}
        yield tuple(film in changed for film in range(len(doubtful)))


def _scores(curves: Mapping[tuple[int, int, bool], Curve], sides: Sequence[bool], step: float) -> _Scores:
    reach = max(round(float(np.abs(curve.lags).max()) / step) for curve in curves.values())
    pairs = {(one, other): np.zeros(2 * reach + 1) for one, other in product(range(len(sides)), repeat=2)}
    for (first, second, is_crossed), curve in curves.items():
        if is_crossed == (sides[first] != sides[second]):
            places = np.round(curve.lags / step).astype(int) + reach
            pairs[first, second][places] = np.nan_to_num(curve.scores, nan=0.0)
            pairs[second, first] = pairs[first, second][::-1]
    return _Scores(pairs, len(sides), reach)


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
