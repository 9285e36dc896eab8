"""Sound: the lag by GCC-PHAT at 16 kHz. Right to about a frame, for sound travels 3 ms a metre.

Without a track of sound in the film that can be read, this source is absent.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Float32s, Float64s
from ...errors import FrogError
from ..media import read_sound
from .lines import fit_line
from .pair import Curve, PairLag, maxima
from .recordings import Recording

RATE = 16_000  # samples a second
_BAND = (100.0, 6000.0)  # Hz: below it rumbles, above it AAC has nothing
_LONGEST = 600.0  # seconds that are read
_FULL_SCALE = 32768
_SEGMENT = 10.0  # seconds of the second film that are looked for in the first: a drifting clock smears longer ones
_MOST_SEGMENTS = 24
_QUIET = 1e-4  # root mean square of full scale: a muted track
_TRAVEL = 0.010  # seconds: sound from a few metres farther away
_LEAST_PEAK = 8.0  # standard deviations: noise of a minute reaches 5.5
_SURE_PEAK = 20.0
_SHOWN = 0.5  # seconds to either side of the peak that the curve keeps


def read_audio(film: Recording) -> Float32s | None:
    """(S,) mono samples at RATE from the film's time 0, in [-1, 1]; None without a track that can be read, or any
    sound."""
    if film.path.is_dir():
        return None
    try:
        read = read_sound(film.path, RATE, 1, 0.0, _LONGEST)
    except FrogError:
        return None
    if read is None or len(read) < RATE // 4:
        return None
    samples = read[:, 0].astype(np.float32) / np.float32(_FULL_SCALE)
    return samples if float(np.sqrt(np.mean(samples.astype(np.float64) ** 2))) >= _QUIET else None


def audio_lag(pair: tuple[int, int], sounds: tuple[Float32s, Float32s]) -> PairLag | None:
    """The lag at which two films sound alike; None where no peak stands out.

    Args:
        pair: indices of the films.
        sounds: their samples (S,) at RATE.
    """
    first, second = sounds
    length = int(_SEGMENT * RATE)
    count = max(1, len(second) // length)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_SEGMENTS)).round().astype(int))
    found = []
    for segment in chosen:
        start = segment * length
        piece = second[start : start + length] if count > 1 else second
        curve = _phase_correlation(first, piece)
        lag, prominence = _peak(curve)
        if prominence >= _LEAST_PEAK:
            middle = (start + len(piece) / 2) / RATE
            found.append((middle, lag - start / RATE, prominence, curve, start / RATE))
    if not found:
        return None
    times, lags, prominences = (np.array([entry[part] for entry in found]) for part in range(3))
    line = fit_line(times, lags, prominences, 0.02)
    agreeing = float(line.agrees.sum()) / len(chosen)
    best = found[int(np.where(line.agrees, prominences, 0).argmax())]
    return PairLag(
        first=pair[0],
        second=pair[1],
        lag=line.value,
        at=line.at,
        sigma=_TRAVEL,
        score=agreeing * float(np.clip(best[2] / _SURE_PEAK, 0, 1)),
        source="audio",
        rate=1 + line.slope,
        rate_sigma=line.slope_sigma,
        curve=_shown(best[3], best[1] + best[4], best[4]),
    )


def _phase_correlation(first: Float32s, second: Float32s) -> Curve:
    """The generalised cross-correlation with phase transform over lags, seconds; both signals whole."""
    size = 1 << int(np.ceil(np.log2(len(first) + len(second))))
    cross = np.fft.rfft(first, size) * np.conj(np.fft.rfft(second, size))
    frequencies = np.fft.rfftfreq(size, 1 / RATE)
    inside = (frequencies >= _BAND[0]) & (frequencies <= _BAND[1])
    magnitude = np.abs(cross)
    # Where neither film has sound there is no phase, only noise of the encoder.
    floor = 1e-3 * float(magnitude[inside].mean()) + 1e-20
    whitened = np.where(inside, cross / (magnitude + floor), 0)
    values = np.roll(np.fft.irfft(whitened, size), len(second) - 1)[: len(first) + len(second) - 1]
    lags = np.arange(-(len(second) - 1), len(first)) / RATE
    return Curve(lags, values)


def _peak(curve: Curve) -> tuple[float, float]:
    """The lag of the highest value, seconds, and by how many standard deviations it stands out."""
    # By the median: the peak and its reflections must not count as noise.
    deviation = 1.4826 * float(np.median(np.abs(curve.scores)))
    prominence = float(curve.scores.max() / max(deviation, 1e-20))
    top = int(curve.scores.argmax())
    part = slice(max(top - 2, 0), top + 3)
    found = maxima(Curve(curve.lags[part], curve.scores[part]), 1.0, most=1)
    return (found[0][0] if found else float(curve.lags[top])), prominence


def _shown(curve: Curve, lag: float, shift: float) -> Curve:
    """The part of a curve about its peak, its lags counted from the film's start: the maximum of each millisecond."""
    near = np.abs(curve.lags - lag) <= _SHOWN
    lags: Float64s = curve.lags[near] - shift
    scores = np.abs(curve.scores[near])
    step = RATE // 1000
    whole = len(lags) // step * step
    if not whole:
        return Curve(lags, scores)
    return Curve(lags[:whole].reshape(-1, step).mean(axis=1), scores[:whole].reshape(-1, step).max(axis=1))
