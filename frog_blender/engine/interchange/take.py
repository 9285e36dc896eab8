"""What is given to another program: Gaussians frame by frame, with the cameras, the rate and the sound around them.

The sound is that of the first of the capture's films that has any, or one made of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..capture import media
from ..editing.edited_scene import RetimedScene
from ..editing.edits import Timing
from ..errors import found_instead
from ..gaussians import NumpyGaussians
from ..playback.player import ScenePlayer
from ..scene.header import SceneHeader
from ..source_media.retimed_sound import retimed_sound
from ..source_media.sound import RATE, find_sound, read_sound, wav_of

FIRST_NUMBER = 1
"""Frame number that a capture's first frame has outside Blender: timelines begin at 1 there as here."""
_CHANNELS, _BITS_A_SECOND = 2, 96_000


@dataclass(frozen=True)
class Sound:
    """What was heard.

    Attributes:
        path: a film with a track of sound, or a sound file.
        start: second of it that a take's first frame shows.
        content: of a sound file, where it was made of the film for a retimed take; empty for the film's own sound.
    """

    path: Path
    start: float = 0.0
    content: bytes = b""


@dataclass(frozen=True)
class TakeFrame:
    """One frame of a take.

    Attributes:
        number: its frame number in the other program.
        time: in the capture, frames counted from 0.
        gaussians: in the capture's own space.
        placement: (4, 4) from that space to the other program's world; None where they are the same.
    """

    number: float
    time: float
    gaussians: NumpyGaussians
    placement: Array | None = None


class Take(Protocol):
    """Frames that can be gone through, more than once, with as many Gaussians in each.

    Attributes:
        name: of the scene, for objects made of it.
        header: the scene file's header.
        num_dynamic: Gaussians that change over time, the first rows.
        changing: names of their columns that do (see playback.frame_delta).
        keeps_identity: whether the same row is the same Gaussian in each.
        rate: frames a second.
        numbers: frame numbers, ascending.
        sound: what plays with it from frame ``numbers[0]`` on; None for silence.
    """

    @property
    def name(self) -> str: ...
    @property
    def header(self) -> SceneHeader: ...
    @property
    def num_dynamic(self) -> int: ...
    @property
    def changing(self) -> Sequence[str]: ...
    @property
    def keeps_identity(self) -> bool: ...
    @property
    def rate(self) -> float: ...
    @property
    def numbers(self) -> Sequence[float]: ...
    @property
    def sound(self) -> Sound | None: ...

    def frames(self) -> Iterator[TakeFrame]:
        """Each frame, in order; FrogError where one cannot be made."""
        ...


def duration_of(take: Take) -> float:
    """Seconds that a take lasts, the last frame's own included."""
    last = take.numbers[-1] + (take.numbers[-1] - take.numbers[-2] if len(take.numbers) > 1 else 1.0)
    return float((last - take.numbers[0]) / take.rate)


@dataclass(frozen=True)
class SceneTake:
    """Frames of a scene as it was captured, or as a retiming has it: a ``Take``.

    Attributes:
        scene: the scene.
        name: of the scene.
        chosen: frames of the capture, or of the retiming, counted from 0, ascending, at least one.
        sound: see ``Take``.
        timing: the retiming; None for none.
    """

    scene: ScenePlayer
    name: str
    chosen: range
    sound: Sound | None = None
    timing: Timing | None = None
    numbers: Sequence[float] = field(init=False)

    def __post_init__(self) -> None:
        first = FIRST_NUMBER if self.timing is None else self.timing.start
        object.__setattr__(self, "numbers", tuple(float(frame + first) for frame in self.chosen))

    @property
    def header(self) -> SceneHeader:
        """The scene file's header."""
        return self.scene.header

    @property
    def num_dynamic(self) -> int:
        """Gaussians that change over time."""
        if self._appears:
            return self.scene.count
        return self.scene.num_dynamic if self.changing else 0

    @property
    def changing(self) -> Sequence[str]:
        """Columns that change; none in a single frame."""
        if self._appears:
            return self.scene.columns
        return self.scene.changing if len(self.chosen) > 1 else ()

    @property
    def keeps_identity(self) -> bool:
        """Whether the same row is the same Gaussian in each frame."""
        return self.scene.keeps_identity

    @property
    def rate(self) -> float:
        """Frames a second."""
        return self.header.frames_per_second if self.timing is None else self.timing.rate

    def frames(self) -> Iterator[TakeFrame]:
        """Each frame, in order."""
        if self.timing is None:
            for frame in self.chosen:
                yield TakeFrame(frame + FIRST_NUMBER, frame, self.scene.at_frame(frame))
            return
        retimed = RetimedScene(self.scene, self.timing)
        for number, frame in zip(self.numbers, self.chosen, strict=True):
            yield TakeFrame(number, self.timing.capture_frame(frame), retimed.at_frame(frame))

    @property
    def _appears(self) -> bool:
        """Whether the scene is there in some frames and not in others."""
        frames = () if self.timing is None else self.timing.frames
        return len({frames[frame] is None for frame in self.chosen}) > 1 if frames else False


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
