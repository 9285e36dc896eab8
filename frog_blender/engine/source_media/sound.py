"""The sound of a film as samples, and samples as the content of a WAV file."""

from __future__ import annotations

import io
import re
import subprocess
import wave
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture.ffmpeg import notes, program, whole_path
from ..errors import FrogError, brief

RATE = 48_000
"""Samples a second of what is read by ffmpeg."""
_CHANNELS = 2
_TRACK = re.compile(r"Stream #\d+:\d+.*: Audio: ")
_PATIENCE = 300.0  # seconds for ffmpeg
_MARGIN = 10.0  # seconds before what is read, in which ffmpeg finds its place
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
        before, found = max(-first, 0), self.values[max(first, 0) : max(first + count, 0)]
        after = max(count - before - len(found), 0)
        return Samples(np.pad(found, ((min(before, count), after), (0, 0))), self.rate)


def has_sound(path: Path) -> bool:
    """Whether a film has a track of sound; False as well where there is no ffmpeg to tell."""
    return bool(_TRACK.search(notes(path)))


def read_sound(path: Path, start: float, seconds: float) -> Samples:
    """So many seconds of a film's sound from a second of it on, in stereo; silence before its begin and after its end.

    Raises:
        FrogError: where ffmpeg is missing or fails, or for more than an hour of sound.
    """
    check_program(path, "reading")
    check_length(path, seconds)
    first, last = (max(round(second * RATE), 0) for second in (start, start + seconds))
    # Samples count from the film's time 0, as images do, with silence where the track starts later. ffmpeg lands
    # somewhere before what it seeks, so that it looks for somewhat earlier sound, and times tell what is not needed.
    steady = f"aresample={RATE}:async=1:first_pts={first},asetpts=N,atrim=end_sample={max(last - first, 1)}"
    command = ["-copyts"]
    if first > _MARGIN * RATE:
        command += ["-noaccurate_seek", "-seek_timestamp", "1", "-ss", f"{first / RATE - _MARGIN:.6f}"]
    command += ["-i", whole_path(path), "-vn", "-af", steady, "-ac", str(_CHANNELS), "-ar", str(RATE)]
    command += ["-f", "s16le", "pipe:1"]
    content = converted(path, command, patience=_PATIENCE, may_be_empty=True)
    whole = len(content) // (2 * _CHANNELS) * (2 * _CHANNELS)
    read = Samples(np.frombuffer(content[:whole], "<i2").reshape(-1, _CHANNELS), RATE)
    return read.part(start - first / RATE, seconds)


def check_program(path: Path, doing: str) -> None:
    """FrogError where there is no ffmpeg for ``doing`` something with the sound of a file."""
    if program() is None:
        raise FrogError(f"{path}: {doing} its sound needs the Python package 'imageio-ffmpeg', found none.")


def converted(
    path: Path, arguments: list[str], *, patience: float, given: bytes = b"", may_be_empty: bool = False
) -> bytes:
    """What ffmpeg, which must be there, makes of the sound of a file.

    Args:
        path: of the file, in messages.
        arguments: of ffmpeg, which ends with writing to a pipe.
        patience: seconds.
        given: what it reads from a pipe.

    Raises:
        FrogError: where it fails, or writes nothing that it should.
    """
    command = [program() or "", "-v", "error", "-nostdin", "-protocol_whitelist", "file,pipe", *arguments]
    try:
        done = subprocess.run(command, input=given or None, capture_output=True, timeout=patience, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        raise FrogError(f"{path}: its sound could not be read ({brief(error)}).") from error
    if done.returncode or not (done.stdout or may_be_empty):
        why = "ffmpeg failed" if done.returncode else "ffmpeg wrote nothing"
        reason = brief(done.stderr.decode(errors="replace")).rstrip(".") or why
        raise FrogError(f"{path}: its sound could not be read ({reason}).")
    return done.stdout


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
