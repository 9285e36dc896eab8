"""What is heard with a take: the sound of the first of the capture's films that has any, or one made of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..capture import media
from ..errors import found_instead
from ..scene.header import SceneHeader
from ..source_media.retimed_sound import retimed_sound
from ..source_media.sound import RATE, find_sound, read_sound, wav_of
from .take import Sound

_CHANNELS, _BITS_A_SECOND = 2, 96_000


def sound_of(
    header: SceneHeader,
    scene_file: Path,
    shown: Sequence[float | None],
    rate: float,
    has_sound: Callable[[Path], bool] = media.has_sound,
) -> Sound | None:
    """What is heard while frames of a capture are shown; None where no film with sound is found.

    It is the film's own sound if the frames follow each other as they were filmed, otherwise a retimed one.

    Args:
        shown: the capture's frames, counted from 0; None where nothing is shown.
        rate: frames a second at which they are shown.
        has_sound: tells whether a film has any.

    Raises:
        FrogError: for a sound that cannot be read, and where PyAV is missing and nothing else tells of sound.
    """
    found = find_sound(header, scene_file, has_sound)
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
        frame == min(first + index, max(first, count - 1)) for index, frame in enumerate(shown)
    )


def encoded(sound: Sound, seconds: float) -> bytes:
    """The sound as Opus in Ogg, stereo, so many seconds of it at most.

    Raises:
        FrogError: if PyAV is missing, or the sound cannot be read.
    """
    if sound.content:
        samples: NDArray[np.int16] | None = media.read_sound_file(sound.content, RATE, _CHANNELS)
    else:
        samples = media.read_sound(sound.path, RATE, _CHANNELS, sound.start, seconds)
    if samples is None:
        raise found_instead(sound.path, "no sound", "a film with sound")
    return media.encoded_sound(samples[: round(seconds * RATE)], RATE, _BITS_A_SECOND)
