"""Clicks: sounds whose time can be measured."""

import io
import wave
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from frog_blender.engine.source_media.sound import RATE, Samples, wav_of

_LENGTH = 0.002  # seconds of a click
_APART = 0.02  # seconds after which another one begins


def clicks(times: Iterable[float], seconds: float, rate: int = RATE) -> Samples:
    """A stereo sound that clicks at times, in seconds."""
    values = np.zeros((round(seconds * rate), 2), np.int16)
    for time in times:
        values[round(time * rate) : round((time + _LENGTH) * rate)] = 30_000
    return Samples(values, rate)


def film_of_clicks(path: Path, times: Iterable[float], seconds: float, rate: int) -> Path:
    """A film that clicks; without PyAV a sound file of that name, which Blender's own library takes for the same."""
    sound = clicks(times, seconds)
    if find_spec("av") is None:
        path.write_bytes(wav_of(sound))
        return path
    from support.films import encode, numbered

    return encode(path, numbered(round(seconds * rate), 32, 32), rate=rate, sound=sound.values)


def samples_of(content: bytes) -> Samples:
    """What a WAV file of 16 bits holds."""
    with wave.open(io.BytesIO(content)) as file:
        values = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, file.getnchannels())
        return Samples(values, file.getframerate())


def times_of_clicks(sound: Samples) -> np.ndarray:
    """The times in seconds at which a sound begins to be loud."""
    level = np.abs(sound.values.astype(np.float64)).max(1)
    loud = np.flatnonzero(level > 0.3 * level.max()) if level.any() else np.zeros(0, np.int64)
    first = np.diff(loud, prepend=-sound.rate) > _APART * sound.rate
    return loud[first] / sound.rate
