"""What is given to another program: Gaussians frame by frame, with the cameras, the rate and the sound around them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..arrays import Array
from ..editing.retimed_scene import RetimedScene
from ..editing.timing import Timing
from ..gaussians import NumpyGaussians
from ..playback.player import ScenePlayer
from ..scene.header import SceneHeader

FIRST_NUMBER = 1
"""Frame number that a capture's first frame has outside Blender: timelines begin at 1 there as here."""


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
