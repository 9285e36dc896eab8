"""The first lags of films, by sound, motion, timecodes and named points; and clocks from the lags of all pairs."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from support.films import copied, encode

from frog_blender.engine.capture.readers.footage import footage_at
from frog_blender.engine.capture.synchronization import starts
from frog_blender.engine.capture.synchronization.films import Film
from frog_blender.engine.capture.synchronization.pairs import PairLag, solve
from frog_blender.engine.capture.synchronization.starts import RATE


def speech(seconds: float, seed: int = 3) -> np.ndarray:
    """Bursts of band-limited noise, as long as syllables."""
    random = np.random.default_rng(seed)
    count = int(seconds * RATE)
    spectrum = np.fft.rfft(random.normal(size=count))
    frequencies = np.fft.rfftfreq(count, 1 / RATE)
    spectrum *= np.exp(-0.5 * ((np.log(np.maximum(frequencies, 1)) - np.log(700)) / 0.8) ** 2)
    loudness = np.repeat(random.uniform(0, 1, count // 2400 + 1) ** 2, 2400)[:count]
    sound = np.fft.irfft(spectrum, count) * loudness
    return (0.3 * sound / np.abs(sound).max()).astype(np.float32)


def room(sound: np.ndarray, seed: int) -> np.ndarray:
    """The same with reflections and noise of 10 dB below."""
    random = np.random.default_rng(seed)
    taps = np.zeros(3200)
    taps[0] = 1
    taps[200:] = random.normal(size=3000) * np.exp(-np.arange(3000) / 700) * 0.08
    heard = np.convolve(sound, taps)[: len(sound)]
    noise = random.normal(size=len(heard)) * np.sqrt(np.mean(heard**2) / 10)
    return (heard + noise).astype(np.float32)


@pytest.mark.parametrize("lag", [1.2345, -2.71])
def test_the_lag_is_found_to_a_few_milliseconds(lag: float) -> None:
    whole = speech(16)
    begin = 4 * RATE
    shifted = begin + round(lag * RATE)
    first, second = whole[begin : begin + 8 * RATE], whole[shifted : shifted + 8 * RATE]
    found = starts.audio_lag((0, 1), (room(first, 1), room(second, 2)))
    assert abs(found.lag - lag) < 0.003
    assert found.rate == 1.0
    assert abs(found.curve.lags[int(found.curve.scores.argmax())] - lag) < 0.003


def test_a_drifting_clock_is_measured() -> None:
    whole = speech(70)
    fast = 1.0005  # seconds of the first film for each second of the second
    times = np.arange(60 * RATE) / RATE
    first = whole[: 65 * RATE]
    second = np.interp(2.0 + fast * times, np.arange(len(whole)) / RATE, whole).astype(np.float32)
    found = starts.audio_lag((0, 1), (first, second))
    assert abs(found.rate - fast) < 2e-5
    assert abs(found.lag - (2.0 + (fast - 1) * found.at)) < 0.002


def test_different_sounds_have_no_lag() -> None:
    assert starts.audio_lag((0, 1), (speech(8, 1), speech(8, 2))) is None


def opened(path: Path) -> Film:
    return Film("a", path, footage_at(path).facts)


def test_sound_is_read_from_the_films_own_zero(tmp_path: Path) -> None:
    images, sound = [np.full((48, 64, 3), 5 * frame, np.uint8) for frame in range(40)], speech(3)
    assert starts.read_audio(opened(encode(tmp_path / "a.mp4", images, rate=10))) is None
    samples = (32_767 * sound).astype(np.int16)[:, None]
    film = encode(tmp_path / "b.mp4", images, rate=10, sound=samples, sound_rate=RATE)
    late = copied(film, tmp_path / "c.mp4", sound_delay=0.5)
    for path, delay in ((film, 0.0), (late, 0.5)):
        heard = starts.read_audio(opened(path))
        assert heard is not None
        found = starts.audio_lag((0, 1), (heard, sound))
        assert abs(found.lag - delay) < 0.03  # the encoder's own delay
    muted = encode(tmp_path / "d.mp4", images, rate=10, sound=0 * samples, sound_rate=RATE)
    assert starts.read_audio(opened(muted)) is None


# --- motion energy


def motion(times: np.ndarray) -> np.ndarray:
    """An energy that does not repeat itself."""
    return 4 + np.sin(3.1 * times) + np.sin(5.3 * times + 1) + np.sin(7.9 * times**1.1 + 2)


def signal(start: float, rate: float, seconds: float = 6.0, gain: float = 1.0) -> starts.Signal:
    times = np.arange(0, seconds, 1 / rate)
    return times, gain * motion(times + start + 3)


@pytest.mark.parametrize(("rates", "lag"), [((30, 30), 0.0), ((24, 30), 0.737), ((60, 25), -1.913)])
def test_energy_finds_the_lag_to_a_tenth_of_a_frame(rates: tuple[float, float], lag: float) -> None:
    first, second = signal(0, rates[0]), signal(lag, rates[1], gain=3.0)
    found = starts.energy_lag((0, 1), (first, second), 1 / max(rates))
    assert abs(found.lag - lag) < 0.1 / min(rates)
    assert found.score > 0.9


def test_a_repeating_motion_has_rivals() -> None:
    times = np.arange(0, 6, 1 / 30)
    wave = 4 + np.sin(2 * np.pi * times) + 0.5 * np.sin(4 * np.pi * times + 1)
    found = starts.energy_lag((0, 1), ((times, wave), (times, wave)), 1 / 30)
    assert found is not None
    assert any(abs(abs(rival) - 1.0) < 0.02 for rival in found.rivals)


def test_films_without_motion_or_too_short_have_no_lag() -> None:
    still = (np.arange(60) / 30, np.zeros(60))
    assert starts.energy_lag((0, 1), (still, signal(0, 30)), 1 / 30) is None
    short = signal(0, 30, seconds=0.1)
    assert starts.energy_lag((0, 1), (short, short), 1 / 30) is None


# --- timecodes


def test_a_film_tells_its_timecode(tmp_path: Path) -> None:
    silent = encode(tmp_path / "a.mp4", [np.full((48, 64, 3), level, np.uint8) for level in (20, 120, 220)], rate=30)
    told = copied(silent, tmp_path / "b.mp4", timecode="01:02:03:15")
    assert starts.read_timecode(Film("b", told, footage_at(told).facts)) == pytest.approx(3723.5)
    assert starts.read_timecode(Film("a", silent, footage_at(silent).facts)) is None


@pytest.mark.parametrize("codes", [(50.0, 53.4), (86_398.0, 1.4)])  # the second after midnight
def test_timecodes_choose_between_maxima(codes: tuple[float, float]) -> None:
    lag = PairLag(0, 1, 5.0, 0.0, 0.01, 0.9, "energy", others=((1.0, 0.8), (3.0, 0.7)))
    chosen = starts.preferred(lag, codes)
    assert (chosen.lag, chosen.score, chosen.others) == (3.0, 0.7, ((5.0, 0.9), (1.0, 0.8)))
    assert starts.preferred(lag, (None, 53.4)) is lag and starts.preferred(lag, (50.0, 58.0)) is lag


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
