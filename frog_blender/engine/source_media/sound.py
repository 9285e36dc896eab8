"""A scene's sound: in a film of its capture or in a file beside it; as samples, and as the content of a WAV file."""

from __future__ import annotations

import io
import wave
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture import media
from ..capture.readers import open_capture
from ..capture.readers.footage import footage_at
from ..errors import FrogError, found_instead
from ..scene.header import SceneHeader
from .clips import capture_folders, find_clips

RATE = 48_000
"""Samples a second of what is read."""
SUFFIXES = (".ogg", ".opus", ".wav", ".flac", ".mp3", ".m4a")
"""Endings of a file beside a scene, of the scene's name: ``take.ogg`` is what is heard with ``take.frog``."""
_CHANNELS = 2
_LONGEST = 3600.0  # seconds that are held in memory
_FULL_SCALE = 32767


@dataclass(frozen=True)
class Samples:
    """A sound.

    Attributes:
        values: (S, C) int16, or float32 in [-1, 1], of C channels.
        rate: samples a second.
    """

    values: Array
    rate: int

    def part(self, start: float, seconds: float) -> Samples:
        """So many seconds from a second on, which may be negative; silence where there is no more."""
        first, count = round(start * self.rate), round(seconds * self.rate)
        before, heard = max(-first, 0), self.values[max(first, 0) : max(first + count, 0)]
        after = max(count - before - len(heard), 0)
        return Samples(np.pad(heard, ((min(before, count), after), (0, 0))), self.rate)


@dataclass(frozen=True)
class FilmSound:
    """A film that has sound, or a file of sound.

    Attributes:
        path: of the film.
        start: its second that the capture's frame 0 shows; negative if it began to film later.
    """

    path: Path
    start: float


def find_sound(
    header: SceneHeader, scene_file: Path, has_sound: Callable[[Path], bool] = media.has_sound
) -> FilmSound | None:
    """The first film of a capture that has sound, else the file of that name beside the scene; None for silence.

    Raises:
        FrogError: of ``has_sound``, where nothing can tell whether a film that is there has any.
    """
    for folder in capture_folders(header, scene_file):
        clips = find_clips(header, folder)
        for clip in clips.values():
            if clip.kind == "VIDEO" and has_sound(clip.path):
                return FilmSound(clip.path, _start_of(folder, clip.path))
        if clips:
            break
    named = (scene_file.with_suffix(suffix) for suffix in SUFFIXES)
    beside = next((path for path in named if path.is_file()), None)
    return FilmSound(beside, 0.0) if beside is not None and has_sound(beside) else None


def _start_of(folder: Path, film: Path) -> float:
    """By an image of the film that the capture has; 0 where the capture cannot be read any more."""
    try:
        capture = open_capture(folder)
        shot = next((shot for shot in capture.shots if shot.path == film), None)
        times = media.read_film_header(film, with_times=True).times
    except FrogError:
        return 0.0
    if shot is None or times is None or shot.index >= len(times):
        return 0.0
    return float(times[shot.index]) - (shot.frame + shot.offset) / capture.frames_per_second


def read_sound(path: Path, start: float, seconds: float) -> Samples:
    """So many seconds of a film's sound, of its chapters where it has such, from a second of it on, in stereo; silence
    before its begin and after its end.

    Raises:
        FrogError: where it cannot be read, or for more than an hour of sound.
    """
    check_length(path, seconds)
    footage = footage_at(path)
    values = np.zeros((round(seconds * RATE), _CHANNELS), np.int16)
    for file, begin in zip(footage.files, footage.begins, strict=True):
        first = max(begin - start, 0.0)
        heard = media.read_sound(file, RATE, _CHANNELS, max(start - begin, 0.0), max(seconds - first, 0.0))
        if heard is None:
            raise found_instead(file, "no sound", "a film with sound")
        left = values[round(first * RATE) :]
        left[: len(heard)] = heard[: len(left)]
    return Samples(values, RATE)


def check_length(what: Path | str, seconds: float) -> None:
    """FrogError for a sound that is too long to be held in memory."""
    if seconds > _LONGEST:
        raise FrogError(f"{what}: found {seconds:,.0f} seconds of sound, expected at most {_LONGEST:,.0f}.")


def wav_of(samples: Samples) -> bytes:
    """The content of a WAV file, 16 bits a sample."""
    values = samples.values
    if values.dtype != np.int16:
        values = np.rint(np.clip(values, -1, 1) * _FULL_SCALE)
    file = io.BytesIO()
    with wave.open(file, "wb") as writer:
        writer.setnchannels(values.shape[1])
        writer.setsampwidth(2)
        writer.setframerate(samples.rate)
        writer.writeframes(np.ascontiguousarray(values, "<i2").tobytes())
    return file.getvalue()
