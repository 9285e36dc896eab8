"""From pairwise lags to clocks: robust, honest about what contradicts, the smallest offsets where motion repeats."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from frog_blender.engine.capture.synchronization.pairs import PairLag, solve

FRAME = 1 / 30


def lags_of(offsets: list[float], at: float = 0.0, rates: list[float] | None = None) -> list[PairLag]:
    """Exact lags between all films, with rates measured where they are given."""
    speeds = rates or [1.0] * len(offsets)
    sigma = 1e-6 if rates else float("inf")
    lags = []
    for i, j in combinations(range(len(offsets)), 2):
        lag = (offsets[j] + speeds[j] * at - offsets[i]) / speeds[i] - at
        lags.append(PairLag(i, j, lag, at, 0.02 * FRAME, 0.8, "motion", speeds[j] / speeds[i], sigma))
    return lags


def test_exact_lags_give_the_offsets_from_the_earliest_on() -> None:
    truth = [0.3, -0.2, 1.7, 0.05]
    solution = solve(4, lags_of(truth), FRAME, 10.0)
    np.testing.assert_allclose(solution.clocks.offsets, np.array(truth) + 0.2, atol=1e-6)
    np.testing.assert_array_equal(solution.clocks.rates, 1.0)
    np.testing.assert_allclose(solution.support, 1.0)
    np.testing.assert_allclose(solution.open_triangles, 0.0)


def test_wrong_pairs_change_nothing() -> None:
    truth = [0.0, 0.4, -0.3, 0.9, 0.2]
    pairs = lags_of(truth)
    pairs[2] = replace(pairs[2], lag=pairs[2].lag + 3.0)
    pairs[7] = replace(pairs[7], lag=pairs[7].lag - 1.0)
    solution = solve(5, pairs, FRAME, 10.0)
    offsets = solution.clocks.offsets
    np.testing.assert_allclose(offsets - offsets[0], truth, atol=0.02 * FRAME)
    assert np.abs(solution.misses[[2, 7]]).min() > 0.9
    assert np.flatnonzero(solution.support < 1).tolist() == [0, 2, 3]  # of the pairs 0-3 and 2-3
    assert solution.open_triangles.max() > 0.2


def test_rivals_of_repeating_motion_are_chosen_so_that_all_agree_and_offsets_are_small() -> None:
    period, truth = 1.0, [0.0, 0.3, -0.35, 0.45]
    pairs = []
    for pair in lags_of(truth):
        # Each pair's best maximum is any of the repetitions; the others score as well.
        shifted = pair.lag + period * ((pair.first + 2 * pair.second) % 3 - 1)
        others = tuple((shifted + k * period, 0.78) for k in (-2, -1, 1, 2))
        pairs.append(replace(pair, lag=shifted, others=others))
    offsets = solve(4, pairs, FRAME, 10.0).clocks.offsets
    wrapped = (offsets - offsets[0] - truth + period / 2) % period - period / 2
    np.testing.assert_allclose(wrapped, 0, atol=1e-4)
    assert np.ptp(offsets) < period


def test_a_fast_clock_is_found_and_the_others_keep_their_rate() -> None:
    rates = [1.0, 1.0, 1.001, 1.0]
    truth = [0.0, 0.2, -0.1, 0.5]
    solution = solve(4, lags_of(truth, at=20.0, rates=rates), FRAME, 40.0)
    np.testing.assert_allclose(solution.clocks.rates, rates, atol=1e-8)
    offsets = solution.clocks.offsets
    np.testing.assert_allclose(offsets - offsets[0], truth, atol=1e-5)


def test_a_rate_within_its_doubt_is_none() -> None:
    pairs = [replace(pair, rate=1.00001, rate_sigma=1e-5) for pair in lags_of([0.0, 0.1], at=20.0)]
    np.testing.assert_array_equal(solve(2, pairs, FRAME, 40.0).clocks.rates, 1.0)


def test_a_film_without_pairs_is_said_to_be_lost() -> None:
    pairs = lags_of([0.0, 0.1, 0.2])
    solution = solve(4, pairs, FRAME, 10.0)
    assert solution.connected.tolist() == [True, True, True, False]
    assert solution.support[3] == 0
    assert np.isnan(solution.open_triangles[3])
    nothing = solve(3, [], FRAME, 10.0)
    assert not nothing.connected.any() and not nothing.clocks.offsets.any()
