"""The first lags of films: by their sound, else by how much moves when.

Sound is right to about a frame, for it travels 3 ms a metre. Motion energy needs neither cameras nor sound, but views
must see the same motion: far apart it is a frame or more wrong. A timecode has whole frames and a clock of its own.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray
from ...io.work_folder import WorkFolder, key_of
from ..media import read_sound
from ..video import load_opencv
from . import limits
from .films import Film, spread
from .pairs import Curve, PairLag, maxima, vertex

RATE = 16_000
"""Samples of sound a second."""
_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)[:;.](\d\d)")
_DAY = 86_400.0

Signal = tuple[Float64s, Float64s]
"""Film times in seconds, and values there."""


# --- sound


def read_audio(film: Film) -> Float32s | None:
    """(S,) mono samples at RATE from the film's time 0, in [-1, 1]; None without a track, or any sound. FrogError for a
    track that cannot be read."""
    if film.path.is_dir():
        return None
    sound = read_sound(film.path, RATE, 1, 0.0, limits.AUDIO_LONGEST)
    if sound is None or len(sound) < RATE // 4:
        return None
    samples = sound[:, 0].astype(np.float32) / np.float32(32_768)
    return samples if float(np.sqrt(np.mean(samples.astype(np.float64) ** 2))) >= limits.AUDIO_QUIET else None


def audio_lag(pair: tuple[int, int], sounds: tuple[Float32s, Float32s]) -> PairLag | None:
    """The lag at which two films sound alike, by GCC-PHAT; None where no peak stands out.

    Args:
        pair: indices of the films.
        sounds: their samples (S,) at RATE.
    """
    first, second = sounds
    length = int(limits.AUDIO_SEGMENT * RATE)
    count = max(1, len(second) // length)
    chosen = spread(count, limits.AUDIO_SEGMENTS)
    heard, curves = [], []
    for start in (segment * length for segment in chosen):
        piece = second[start : start + length] if count > 1 else second
        curve = _phase_correlation(first, piece, start)
        lag, prominence = _peak(curve)
        if prominence >= limits.AUDIO_LEAST_PEAK:
            heard.append(((start + len(piece) / 2) / RATE, lag, prominence))
            curves.append(curve)
    if not heard:
        return None
    times, lags, prominences = np.array(heard).T
    value, slope, slope_sigma, agrees = _drift(times, lags)
    if not agrees.any():
        return None
    best = int(np.where(agrees, prominences, 0).argmax())
    sureness = float(np.clip(prominences[best] / limits.AUDIO_SURE_PEAK, 0, 1))
    score, middle, shown = float(agrees.sum()) / len(chosen) * sureness, float(times[agrees].mean()), curves[best]
    rate = 1 + slope, slope_sigma
    return PairLag(*pair, value, middle, limits.AUDIO_TRAVEL, score, "audio", *rate, curve=_shown(shown, lags[best]))


def _drift(times: Float64s, lags: Float64s) -> tuple[float, float, float, Bools]:
    """The lag at the middle of the times (N,) that agree, its slope over time and that one's standard deviation, and
    which agree: outliers aside. Infinite where too few times, or too short a time, told the slope, which then is 0.
    """
    slope = 0.0
    drifts = len(times) > 2 and float(np.ptp(times)) >= limits.DRIFT_SECONDS
    if drifts:  # Theil and Sen: the median of the slopes between far times
        first, second = np.nonzero(times[None] - times[:, None] > limits.DRIFT_SECONDS / 2)
        slope = float(np.median((lags[second] - lags[first]) / (times[second] - times[first])))
    straight = lags - slope * times
    # The value that most share, where every one may be an outlier.
    near = np.abs(straight[:, None] - straight) <= limits.AUDIO_TOLERANCE
    agrees = near[int(near.sum(axis=1).argmax())]
    t, v = times[agrees], lags[agrees]
    spread = float(((t - t.mean()) ** 2).sum())
    if not drifts or len(t) < 3 or float(np.ptp(t)) < limits.DRIFT_SECONDS:
        return float(v.mean()), 0.0, float("inf"), agrees
    slope = float(((t - t.mean()) * v).sum() / spread)
    scatter = v - v.mean() - slope * (t - t.mean())
    noise = max(float((scatter**2).sum()) / (len(t) - 2), (limits.AUDIO_TOLERANCE / 100) ** 2)
    return float(v.mean()), slope, float(np.sqrt(noise / spread)), agrees


def _phase_correlation(first: Float32s, second: Float32s, start: int) -> Curve:
    """The generalised cross-correlation with phase transform over lags, seconds; both signals whole, the second of a
    film from sample ``start`` on."""
    size = 1 << int(np.ceil(np.log2(len(first) + len(second))))
    cross = np.fft.rfft(first, size) * np.conj(np.fft.rfft(second, size))
    frequencies = np.fft.rfftfreq(size, 1 / RATE)
    inside = (frequencies >= limits.AUDIO_BAND[0]) & (frequencies <= limits.AUDIO_BAND[1])
    magnitude = np.abs(cross)
    # Where neither film has sound there is no phase, only noise of the encoder.
    floor = 1e-3 * float(magnitude[inside].mean()) + 1e-20
    whitened = np.where(inside, cross / (magnitude + floor), 0)
    values = np.roll(np.fft.irfft(whitened, size), len(second) - 1)[: len(first) + len(second) - 1]
    return Curve(np.arange(-(len(second) - 1) - start, len(first) - start) / RATE, values)


def _peak(curve: Curve) -> tuple[float, float]:
    """The lag of the highest value, seconds, and by how many standard deviations it stands out."""
    # By the median: the peak and its reflections must not count as noise.
    deviation = 1.4826 * float(np.median(np.abs(curve.scores)))
    prominence = float(curve.scores.max() / max(deviation, 1e-20))
    return vertex(curve.lags, curve.scores, int(curve.scores.argmax())), prominence


def _shown(curve: Curve, lag: float) -> Curve:
    """The part of a curve about its peak: the maximum of each millisecond."""
    near = np.abs(curve.lags - lag) <= limits.AUDIO_SHOWN
    step = RATE // 1000
    whole = int(near.sum()) // step * step
    lags, scores = curve.lags[near][:whole].reshape(-1, step), np.abs(curve.scores[near][:whole]).reshape(-1, step)
    return Curve(lags.mean(axis=1), scores.max(axis=1)) if whole else Curve()


# --- motion energy


@dataclass(frozen=True, eq=False)
class Motion:
    """What moves in a film, by one pass over all of it.

    Attributes:
        times: (N - 1,) seconds in the film, between each two frames.
        energies: (N - 1,) how much changes there by second.
        region: (H, W) uint8 of the gray images, 255 where something moves, and nothing of the background.
    """

    times: Float64s
    energies: Float64s
    region: ImageArray


def motion_of(film: Film, work: WorkFolder) -> Motion:
    """Decodes a film once, unless what came of it was kept; FrogError if it cannot be decoded."""

    def seen() -> dict[str, Array]:
        count = film.facts.frame_count
        sampled = spread(count, limits.BACKGROUND_SAMPLES)
        small: ImageArray | None = None
        changes, samples = [], []
        for index, gray in enumerate(film.gray(range(count), limits.LONGEST_SIDE)):
            before, small = small, _reduced(gray)
            if before is not None:
                changes.append(float(np.maximum(np.abs(small - before) - limits.ENERGY_NOISE, 0).mean()))
            if index in sampled:
                samples.append(gray)
        times = (film.stamps[1:] + film.stamps[:-1]) / 2
        energies = np.array(changes) / np.maximum(np.diff(film.stamps), 1e-6)
        return {"times": times, "energies": energies, "region": changing_region(samples)}

    return Motion(**work.kept("motion", key_of(film.state), seen))


def _reduced(gray: ImageArray) -> ImageArray:
    """A small image without details: of them, only noise would be left between two frames."""
    cv2 = load_opencv()
    height = max(2, round(gray.shape[0] * limits.ENERGY_WIDTH / gray.shape[1]))
    small = cv2.resize(gray, (limits.ENERGY_WIDTH, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small.astype(np.float32), (0, 0), limits.ENERGY_BLUR))


def changing_region(images: Sequence[ImageArray]) -> ImageArray:
    """(H, W) uint8 mask, 255 where gray images (each (H, W) uint8) of one view deviate from their median."""
    cv2 = load_opencv()
    stack = np.stack([cv2.GaussianBlur(image, (0, 0), 1.0) for image in images])
    median = np.median(stack, axis=0).astype(np.float32)
    # A high percentile, not the mean: a hand that passes once changes a pixel in few of the images.
    deviation = np.percentile(np.abs(stack.astype(np.float32) - median), 90, axis=0)
    mask = (deviation > limits.CHANGE).astype(np.uint8) * 255
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    radius = max(2, round(limits.REGION_MARGIN * mask.shape[1]))
    shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.dilate(mask, shape))


def energy_lag(pair: tuple[int, int], signals: tuple[Signal, Signal], step: float) -> PairLag | None:
    """The lag at which two films' energies correlate best; None where they never overlap enough or nothing moves.

    Args:
        pair: indices of the films.
        signals: their times (seconds) and energies.
        step: seconds between samples, the shorter frame interval of the two.
    """
    first, second = (_resampled(signal, step) for signal in signals)
    least = max(limits.ENERGY_LEAST_SAMPLES, int(limits.ENERGY_LEAST_SHARE * min(len(first[1]), len(second[1]))))
    shifts, scores = _normalized_correlation(first[1], second[1], least)
    if not len(shifts):
        return None
    curve = Curve(shifts * step + first[0] - second[0], scores)
    peaks = maxima(curve, 2 * step)
    if not peaks or peaks[0][1] <= 0:
        return None
    (lag, score), *others = peaks
    middle, sigma = second[0] + len(first[1]) * step / 2, step * max(0.1, 1.5 * (1 - score))
    return PairLag(*pair, lag, middle, sigma, score, "energy", others=tuple(others), curve=curve)


def _resampled(signal: Signal, step: float) -> tuple[float, Float64s]:
    """The time of the first sample, and evenly spaced samples of a smoothed signal."""
    times, values = signal
    even = np.arange(times[0], times[-1] + step / 2, step)
    # Motion is told by ratios: twice as near a camera, everything changes twice as much.
    samples = np.interp(even, times, np.sqrt(values))
    radius = 2
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / limits.ENERGY_SMOOTHING) ** 2)
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


# --- timecodes


def read_timecode(film: Film) -> float | None:
    """The second of a day at which a film's timecode says that it began; None without one."""
    told = _TIMECODE.fullmatch(film.facts.header.tags.get("timecode", ""))
    if told is None:
        return None
    hours, minutes, seconds, frames = (int(part) for part in told.groups())
    return 3600 * hours + 60 * minutes + seconds + frames * film.interval


def preferred(lag: PairLag, codes: tuple[float | None, float | None]) -> PairLag:
    """The best maximum near what two films' timecodes say; without one there, or timecodes, the best of all."""
    first, second = codes
    if first is None or second is None:
        return lag
    told = (second - first + _DAY / 2) % _DAY - _DAY / 2  # across midnight the shorter way
    near = [other for other in lag.others if abs(other[0] - told) <= limits.TIMECODE_SLACK]
    if abs(lag.lag - told) <= limits.TIMECODE_SLACK or not near:
        return lag
    rest = ((lag.lag, lag.score), *(other for other in lag.others if other != near[0]))
    return replace(lag, lag=near[0][0], score=near[0][1], others=rest)
