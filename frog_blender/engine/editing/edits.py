"""What is edited of a scene: which Gaussians are hidden, crops, grades, and which frame is shown when. Values; nothing
here plays a scene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..playback.player import ScenePlayer
from .crops import Crop, kept_of_all
from .grades import Grade
from .marks import Marks

MOST_FRAMES = 1_048_574
"""Frames of a retiming: as many as a timeline of Blender has."""
FASTEST_RATE = 1000.0
"""Frames a second."""


@dataclass(frozen=True)
class Timing:
    """A retiming.

    Attributes:
        frames: of the capture, counted from 0, one for each frame that is shown; fractions are legal. None, before the
            first and after the last one that there is, where nothing is shown.
        rate: frames a second.
        start: frame number of the first one on a timeline.

    Raises:
        ValueError: for frames or a rate that cannot be.
    """

    frames: tuple[float | None, ...]
    rate: float
    start: int = 1

    def __post_init__(self) -> None:
        if not 1 <= len(self.frames) <= MOST_FRAMES:
            raise ValueError(f"a timing of {len(self.frames):,} frames")
        if not 0 < self.rate <= FASTEST_RATE:
            raise ValueError(f"a timing at {self.rate:g} frames a second")
        if not all(math.isfinite(frame) for frame in self.frames if frame is not None):
            raise ValueError("a timing with a frame that is not finite")
        shown = [frame is not None for frame in self.frames]
        if sum(before != after for before, after in zip([False, *shown], [*shown, False], strict=True)) > 2:
            raise ValueError("a timing that shows nothing between two of its frames")

    def capture_frame(self, frame: int) -> float:
        """The capture's frame at one of these, counted from 0; 0 where nothing is shown."""
        return self.frames[frame] or 0.0


MOST_CROPS, MOST_GRADES = 100, 100
_KEPT = 0.5  # of an opacity: less counts as taken away where a crop fades


@dataclass(frozen=True)
class Edits:
    """The edits of one scene at one frame.

    Attributes:
        hidden: Gaussians that are not shown; None for none.
        crops: see ``crops.kept_of_all``.
        grades: applied one after the other.
        timing: for those who go through frames (see ``RetimedScene``); None for the capture's own.
    """

    hidden: Marks | None = None
    crops: tuple[Crop, ...] = ()
    grades: tuple[Grade, ...] = ()
    timing: Timing | None = None

    @property
    def are_none(self) -> bool:
        """Whether they change nothing of any frame."""
        return self.hidden is None and not self.crops and all(grade.is_neutral for grade in self.grades)

    def fitted(self, scene: ScenePlayer) -> tuple[Edits, list[str]]:
        """Without marks that were made for another scene, and a sentence about each of those."""
        selections = (("A grade of a selection was", grade.only) for grade in self.grades)
        every = [("Hidden Gaussians were", self.hidden), *selections]
        foreign = [(what, marks) for what, marks in every if marks is not None and not marks.fits(scene)]
        dropped = [marks for _, marks in foreign]
        hidden = None if self.hidden in dropped else self.hidden
        grades = tuple(grade for grade in self.grades if grade.only not in dropped)
        return replace(self, hidden=hidden, grades=grades), [_dropped(what, marks, scene) for what, marks in foreign]


def uncropped(edits: Edits, scene: ScenePlayer, time: float, tint: Grade) -> Edits:
    """Edits whose crops take nothing away: what they would at a time is graded instead.

    Args:
        scene: the file's, which the edits fit.
        tint: that grade; its ``only`` does not matter.
    """
    places = [scene.at(time if crop.time is None else crop.time).means for crop in edits.crops]
    shares = [crop.kept(points) for crop, points in zip(edits.crops, places, strict=True)]
    away = kept_of_all(edits.crops, shares, scene.count) < _KEPT
    tints = (replace(tint, only=Marks.of(scene, away)),) if away.any() else ()
    return replace(edits, crops=(), grades=(*edits.grades, *tints))


def _dropped(what: str, marks: Marks, scene: ScenePlayer) -> str:
    other = f"{marks.count:,} Gaussians" if marks.count != scene.file_count else "another training"
    return f"{what} dropped: made for a scene of {other}, found one of {scene.file_count:,}."
