"""A capture's sound as fast, as slow or as backward as its images: like a tape, with its pitch.

Each frame that is shown plays the sound from the capture's frame in it on, at the speed at which these go on. A sample
is the mean of the sound over the time that it stands for, so that fast sound has weak false tones at most; it is
found from running sums, forwards and backwards alike.
"""

from collections.abc import Sequence

import numpy as np

from ..arrays import Array
from .sound import Samples, check_length

_FASTEST, _SLOWEST = 16.0, 1 / 32
"""Speeds beyond which sound fades: nobody hears what it was, and a frozen image has none."""
_FADE = 0.003  # seconds in which sound comes and goes
_BLOCK = 1 << 16  # samples that are worked on at once


def _frame_speeds(shown: Array) -> Array:
    """(n,) frames of the capture from each shown frame to the next; NaN where nothing is shown.

    Where a capture jumps, as a loop does at its end, it goes on at the speed around the jump.

    Args:
        shown: (n,) frames of the capture; NaN where nothing is shown.
    """
    present = np.flatnonzero(~np.isnan(shown))
    speeds = np.full(len(shown), np.nan)
    if len(present) < 2:
        speeds[present] = 1.0
        return speeds
    steps = np.diff(shown[present])
    steps = np.append(steps, steps[-1])
    around = np.stack([np.append(steps[0], steps[:-1]), steps, np.append(steps[1:], steps[-1])])
    speeds[present] = np.median(around, axis=0)
    return speeds


def heard_frames(shown: Sequence[float | None], frame_count: int, ratio: float) -> range:
    """From the first to the last of the shown frames in which anything of a capture can be heard; empty for none.

    Args:
        shown: frames of the capture, None where nothing is shown.
        frame_count: of the capture.
        ratio: frames a second that are shown for one of the capture, at its own rate.
    """
    frames = np.array(shown, np.float64)
    heard = np.flatnonzero(_is_heard(frames, _frame_speeds(frames), frame_count, ratio))
    return range(int(heard[0]), int(heard[-1]) + 1) if len(heard) else range(0)


def retimed_sound(
    sound: Samples, shown: Sequence[float | None], rate: float, frame_count: int, frames_per_second: float
) -> Samples:
    """The sound of frames that are shown one after the other; silence where nothing is, or nothing moves.

    Args:
        sound: of the capture, from its frame 0 on.
        shown: frames of the capture, counted from 0; None where nothing is shown.
        rate: frames a second at which they are shown.
        frame_count, frames_per_second: of the capture.

    Returns:
        float32 samples at the sound's own rate.

    Raises:
        FrogError: for more than an hour of them.
    """
    check_length("The retimed capture", len(shown) / rate)
    frames = np.array(shown, np.float64)
    speeds = _frame_speeds(frames)
    ratio = rate / frames_per_second
    heard = _is_heard(frames, speeds, frame_count, ratio)
    frame_length = sound.rate / frames_per_second  # samples
    count = round(len(frames) / rate * sound.rate)
    result = np.zeros((count, sound.values.shape[1]), np.float32)
    gains = np.zeros(count, np.float32)
    for start in range(0, count, _BLOCK):
        here = np.arange(start, min(start + _BLOCK, count)) * (rate / sound.rate)
        index = np.minimum(here.astype(np.int64), len(frames) - 1)
        part = slice(start, start + len(index))
        gains[part] = heard[index]
        if gains[part].any() or (start and gains[start - 1]):
            speed = np.nan_to_num(speeds[index])
            places = (np.nan_to_num(frames[index]) + (here - index) * speed) * frame_length
            result[part] = _means(sound.values, places + 0.5, np.maximum(np.abs(speed * ratio), 1.0))
    result *= _smooth(gains, round(_FADE * sound.rate))[:, None]
    return Samples(result, sound.rate)


def _is_heard(frames: Array, speeds: Array, frame_count: int, ratio: float) -> Array:
    """(n,) bool."""
    speed = np.abs(speeds * ratio)
    with np.errstate(invalid="ignore"):
        heard: Array = (speed >= _SLOWEST) & (speed <= _FASTEST) & (frames > -1) & (frames < frame_count)
    return heard


def _means(values: Array, places: Array, widths: Array) -> Array:
    """(K, C) float32 means of (S, C) samples, silence around them, over so many samples about (K,) places."""
    first, last = places - widths / 2, places + widths / 2
    length = len(values)
    low = int(np.clip(np.floor(first.min()), 0, length))
    high = int(np.clip(np.ceil(last.max()), low, length))
    scale = 1 / 32768 if values.dtype == np.int16 else 1.0
    means = np.empty((len(places), values.shape[1]), np.float32)
    for channel in range(values.shape[1]):
        part = values[low:high, channel].astype(np.float64) * scale
        sums = np.concatenate([[0.0], np.cumsum(part)])
        begin, end = (np.interp(ends - low, np.arange(len(sums)), sums) for ends in (first, last))
        means[:, channel] = (end - begin) / widths
    return means


def _smooth(gains: Array, width: int) -> Array:
    """(T,) float32 gains whose steps become ramps, within what was heard before."""
    if width < 2 or len(gains) <= width:
        return gains
    sums = np.concatenate([[0.0], np.cumsum(gains, dtype=np.float64)])
    before = width // 2
    index = np.arange(len(gains))
    low, high = np.maximum(index - before, 0), np.minimum(index + width - before, len(gains))
    return np.asarray(((sums[high] - sums[low]) / (high - low)).astype(np.float32))
