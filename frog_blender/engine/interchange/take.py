"""What is given to another program: Gaussians frame by frame, with the cameras, the rate and the sound around them.

The sound is that of the first of the capture's films that has any, or one made of it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..capture import media
from ..editing.edited_scene import RetimedScene
from ..editing.edits import Timing
from ..errors import printable
from ..gaussians import NumpyGaussians
from ..playback.player import ScenePlayer
from ..playback.render_files import PlayedFrames
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


@dataclass(frozen=True)
class Take:
    """Frames that can be gone through, more than once, with as many Gaussians in each.

    Attributes:
        name: of the scene, for objects made of it.
        header: the scene file's header.
        num_dynamic: Gaussians that change over time, the first rows.
        changing: names of their columns that do (see playback.frame_delta); none in a single frame.
        keeps_identity: whether the same row is the same Gaussian in each.
        rate: frames a second.
        numbers: frame numbers, ascending.
        shown: the capture's frame at each, counted from 0; None where nothing is shown.
        frames: each frame, in order; FrogError where one cannot be made.
        sound: what plays with it from frame ``numbers[0]`` on; None for silence.
    """

    name: str
    header: SceneHeader
    num_dynamic: int
    changing: Sequence[str]
    keeps_identity: bool
    rate: float
    numbers: Sequence[float]
    shown: Sequence[float | None]
    frames: Callable[[], Iterator[TakeFrame]]
    sound: Sound | None = None

    @property
    def seconds(self) -> float:
        """How long it lasts, the last frame's own time included."""
        last = self.numbers[-1] + (self.numbers[-1] - self.numbers[-2] if len(self.numbers) > 1 else 1.0)
        return (last - self.numbers[0]) / self.rate


def scene_take(scene: ScenePlayer, name: str, chosen: Sequence[int], timing: Timing | None = None) -> Take:
    """Frames of a scene as it was captured, or as a retiming has it.

    Args:
        chosen: frames of the capture, or of the retiming, counted from 0, ascending, at least one.
    """
    played: PlayedFrames = scene
    shown: list[float | None] = [*map(float, chosen)]
    first, rate = FIRST_NUMBER, scene.header.frames_per_second
    if timing is not None:
        played, shown = RetimedScene(scene, timing), [timing.frames[frame] for frame in chosen]
        first, rate = timing.start, timing.rate
    numbers = [float(frame + first) for frame in chosen]
    changing, num_dynamic = (scene.changing, scene.num_dynamic) if len(chosen) > 1 and scene.changing else ((), 0)
    if len({frame is None for frame in shown}) > 1:  # there in some frames, and not in others
        changing, num_dynamic = scene.columns, scene.count

    def frames() -> Iterator[TakeFrame]:
        for number, frame, time in zip(numbers, chosen, shown, strict=True):
            yield TakeFrame(number, time or 0.0, played.at_frame(frame))

    name = printable(name)  # a file's may be of bytes that are no text
    return Take(name, scene.header, num_dynamic, changing, scene.keeps_identity, rate, numbers, shown, frames)


def with_sound(take: Take, scene_file: Path, has_sound: Callable[[Path], bool] = media.has_sound) -> Take:
    """A take with what is heard while its frames are shown; without sound where no film with sound is found.

    It is the film's own sound if the frames follow each other as they were filmed, otherwise a retimed one.

    Args:
        has_sound: tells whether a film has any.

    Raises:
        FrogError: for a sound that cannot be read, and where PyAV is missing and nothing else tells of sound.
    """
    header, shown = take.header, take.shown
    film = find_sound(header, scene_file, has_sound)
    if film is None:
        return take
    count, own_rate = header.frame_count, header.frames_per_second
    start = film.start + (shown[0] or 0.0) / own_rate
    if take.rate == own_rate and start >= 0 and _follow_each_other(shown, count):
        return replace(take, sound=Sound(film.path, start))
    samples = read_sound(film.path, film.start, count / own_rate)
    content = wav_of(retimed_sound(samples, shown, take.rate, count, own_rate))
    return replace(take, sound=Sound(film.path, 0.0, content))


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
        samples: NDArray[np.int16] = media.read_sound_file(sound.content, RATE, _CHANNELS)
    else:
        samples = read_sound(sound.path, sound.start, seconds).values
    return media.encoded_sound(samples[: round(seconds * RATE)], RATE, _BITS_A_SECOND)
