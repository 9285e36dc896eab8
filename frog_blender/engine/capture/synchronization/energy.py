"""Motion energy: how much changes from frame to frame, correlated between films. A start, seldom better than 0.1 frame.

It needs neither cameras nor sound, but views must see the same motion: far apart it is a frame or more wrong.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Float64s, ImageArray
from ..video import load_opencv
from .pair import Curve, PairLag, maxima
from .recordings import Recording

_WIDTH = 80  # pixels of the images that are compared
_BLUR = 1.5  # pixels, of these: smaller details than a moving limb only add noise
_NOISE = 2.0  # gray levels of 255 that a difference must exceed
_LEAST_SHARE = 0.25  # of the shorter film must overlap
_LEAST_SAMPLES = 8
_SMOOTHING = 0.5  # frames: a correlation of sampled signals peaks between samples only where they are smooth


class EnergyMeter:
    """Receives a film's frames one by one."""

    def __init__(self) -> None:
        self._last: ImageArray | None = None
        self._values: list[float] = []

    def add(self, gray: ImageArray) -> None:
        """The next frame, (H, W) uint8."""
        cv2 = load_opencv()
        height = max(2, round(gray.shape[0] * _WIDTH / gray.shape[1]))
        small = cv2.resize(gray, (_WIDTH, height), interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small.astype(np.float32), (0, 0), _BLUR)
        if self._last is not None:
            change = np.abs(small - self._last)
            self._values.append(float(np.maximum(change - _NOISE, 0).mean()))
        self._last = small

    def signal(self, film: Recording) -> tuple[Float64s, Float64s]:
        """Times (N - 1,) in the film, seconds, between each two frames, and the change (N - 1,) there by second."""
        times = film.timestamps[: len(self._values) + 1]
        gaps = np.maximum(np.diff(times), 1e-6)
        return (times[1:] + times[:-1]) / 2, np.array(self._values[: len(gaps)]) / gaps


Signal = tuple[Float64s, Float64s]


def energy_lag(pair: tuple[int, int], signals: tuple[Signal, Signal], step: float) -> PairLag | None:
    """The lag at which two films' energies correlate best; None where they never overlap enough or nothing moves.

    Args:
        pair: indices of the films.
        signals: their times (seconds) and energies.
        step: seconds between samples, the shorter frame interval of the two.
    """
    first, second = (_resampled(signal, step) for signal in signals)
    least = max(_LEAST_SAMPLES, int(_LEAST_SHARE * min(len(first[1]), len(second[1]))))
    shifts, scores = _normalized_correlation(first[1], second[1], least)
    if not len(shifts):
        return None
    curve = Curve(shifts * step + first[0] - second[0], scores)
    found = maxima(curve, 2 * step)
    if not found or found[0][1] <= 0:
        return None
    lag, score = found[0]
    overlap = len(first[1]) * step
    return PairLag(
        first=pair[0],
        second=pair[1],
        lag=lag,
        at=second[0] + overlap / 2,
        sigma=step * max(0.1, 1.5 * (1 - score)),
        score=score,
        source="energy",
        others=tuple(found[1:]),
        curve=curve,
    )


def _resampled(signal: Signal, step: float) -> tuple[float, Float64s]:
    """The time of the first sample, and evenly spaced samples of a smoothed signal."""
    times, values = signal
    even = np.arange(times[0], times[-1] + step / 2, step)
    # Motion is told by ratios: twice as near a camera, everything changes twice as much.
    samples = np.interp(even, times, np.sqrt(values))
    radius = 2
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / _SMOOTHING) ** 2)
    smooth = np.convolve(np.pad(samples, radius, mode="edge"), kernel / kernel.sum(), mode="valid")
    return float(even[0]), smooth


def _normalized_correlation(first: Float64s, second: Float64s, least: int) -> tuple[Float64s, Float64s]:
    """Shifts s in samples, and the correlation of first[i + s] with second[i], where ``least`` samples are common."""
    count_a, count_b = len(first), len(second)
    if min(count_a, count_b) < least:
        return np.zeros(0), np.zeros(0)
    size = 1 << (count_a + count_b).bit_length()
    ones_a, ones_b = np.ones(count_a), np.ones(count_b)
    first, second = first - first.mean(), second - second.mean()

    def sums(a: Float64s, b: Float64s) -> Float64s:
        spectrum = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
        return np.roll(np.fft.irfft(spectrum, size), count_b - 1)[: count_a + count_b - 1]

    common = np.round(sums(ones_a, ones_b))
    safe = np.maximum(common, 1)
    sum_a, sum_b = sums(first, ones_b), sums(ones_a, second)
    spread_a = sums(first**2, ones_b) - sum_a**2 / safe
    spread_b = sums(ones_a, second**2) - sum_b**2 / safe
    product = sums(first, second) - sum_a * sum_b / safe
    least_a, least_b = 1e-3 * first.var() + 1e-12, 1e-3 * second.var() + 1e-12
    enough = (common >= least) & (spread_a > least_a * safe) & (spread_b > least_b * safe)
    scores = product / np.sqrt(np.maximum(spread_a * spread_b, 1e-24))
    # A short overlap correlates by chance: what is left of a correlation grows with the samples it was found in.
    scores = scores * np.sqrt(np.maximum(1 - 4.0 / np.maximum(safe, 4), 0))
    shifts = np.arange(-(count_b - 1), count_a)
    return shifts[enough].astype(np.float64), scores[enough]
