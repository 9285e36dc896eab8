"""What is heard with a take: the sound of the first of the capture's films that has any, or one made of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..capture.ffmpeg import whole_path
from ..scene.header import SceneHeader
from ..source_media.film_sound import find_sound
from ..source_media.retimed_sound import retimed_sound
from ..source_media.sound import check_program, converted, read_sound, wav_of
from .take import Sound

_PATIENCE = 120.0  # seconds in which ffmpeg must write a sound
_RATE, _QUALITY = 48_000, "96k"


def sound_of(header: SceneHeader, scene_file: Path, shown: Sequence[float | None], rate: float) -> Sound | None:
    """What is heard while frames of a capture are shown; None where no film with sound is found.

    It is the film's own sound if the frames follow each other as they were filmed, otherwise a retimed one.

    Args:
        shown: the capture's frames, counted from 0; None where nothing is shown.
        rate: frames a second at which they are shown.

    Raises:
        FrogError: for a sound that cannot be read.
    """
    found = find_sound(header, scene_file)
    if found is None:
        return None
    count, own_rate = header.frame_count, header.frames_per_second
    start = found.start + (shown[0] or 0.0) / own_rate
    if rate == own_rate and start >= 0 and _follow_each_other(shown, count):
        return Sound(found.path, start)
    read = read_sound(found.path, found.start, count / own_rate)
    return Sound(found.path, 0.0, wav_of(retimed_sound(read, shown, rate, count, own_rate)))


def _follow_each_other(shown: Sequence[float | None], count: int) -> bool:
    first = shown[0]
    return first is not None and all(
        frame == min(first + place, max(first, count - 1)) for place, frame in enumerate(shown)
    )


def encoded(sound: Sound, seconds: float) -> bytes:
    """The sound as Opus in Ogg, stereo, so many seconds of it; FrogError where ffmpeg is missing or fails."""
    check_program(sound.path, "writing")
    # Of a pipe, which cannot be rewound, ffmpeg would lose what it reads before it seeks.
    command = ["-i", "pipe:0"] if sound.content else ["-ss", f"{sound.start:.6f}", "-i", whole_path(sound.path)]
    command += ["-t", f"{seconds:.6f}", "-vn", "-ac", "2", "-ar", str(_RATE)]
    command += ["-c:a", "libopus", "-b:a", _QUALITY, "-fflags", "+bitexact", "-f", "ogg", "pipe:1"]
    return converted(sound.path, command, patience=_PATIENCE, given=sound.content)
