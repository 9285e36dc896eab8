"""Motion energy: lags between signals of one motion, sampled at different times and rates."""

from __future__ import annotations

import numpy as np
import pytest

from frog_blender.engine.capture.synchronization.energy import EnergyMeter, Signal, energy_lag
from frog_blender.engine.capture.synchronization.recordings import Recording


def motion(times: np.ndarray) -> np.ndarray:
    """An energy that does not repeat itself."""
    return 4 + np.sin(3.1 * times) + np.sin(5.3 * times + 1) + np.sin(7.9 * times**1.1 + 2)


def signal(start: float, rate: float, seconds: float = 6.0, gain: float = 1.0) -> Signal:
    times = np.arange(0, seconds, 1 / rate)
    return times, gain * motion(times + start + 3)


@pytest.mark.parametrize("rates", [(30, 30), (24, 30), (60, 25)])
@pytest.mark.parametrize("lag", [0.0, 0.737, -1.913])
def test_the_lag_is_found_to_a_tenth_of_a_frame(rates: tuple[float, float], lag: float) -> None:
    first, second = signal(0, rates[0]), signal(lag, rates[1], gain=3.0)
    found = energy_lag((0, 1), (first, second), 1 / max(rates))
    assert found is not None
    assert abs(found.lag - lag) < 0.1 / min(rates)
    assert found.score > 0.9


def test_a_repeating_motion_has_rivals() -> None:
    times = np.arange(0, 6, 1 / 30)
    wave = 4 + np.sin(2 * np.pi * times) + 0.5 * np.sin(4 * np.pi * times + 1)
    found = energy_lag((0, 1), ((times, wave), (times, wave)), 1 / 30)
    assert found is not None
    assert any(abs(abs(rival) - 1.0) < 0.02 for rival in found.rivals)


def test_films_without_motion_or_too_short_have_no_lag() -> None:
    still = (np.arange(60) / 30, np.zeros(60))
    assert energy_lag((0, 1), (still, signal(0, 30)), 1 / 30) is None
    short = signal(0, 30, seconds=0.1)
    assert energy_lag((0, 1), (short, short), 1 / 30) is None


def test_the_meter_counts_change_by_second_across_a_gap() -> None:
    stamps = np.array([0.0, 0.1, 0.4, 0.5])
    meter = EnergyMeter()
    for brightness in (10, 40, 70, 100):
        meter.add(np.full((60, 80), brightness, np.uint8))
    times, values = meter.signal(Recording("a", None, stamps, 80, 60))  # type: ignore[arg-type]
    np.testing.assert_allclose(times, [0.05, 0.25, 0.45])
    np.testing.assert_allclose(values * np.diff(stamps), 28, rtol=1e-5)
