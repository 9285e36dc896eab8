"""What is edited of a scene: which Gaussians are hidden, crops and grades. Values; nothing here plays a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..playback.player import ScenePlayer
from .crops import Crop
from .grades import Grade
from .marks import Marks
from .timing import Timing

MOST_CROPS, MOST_GRADES = 100, 100


@dataclass(frozen=True)
class Edits:
    """The edits of one scene at one frame.

    Attributes:
        hidden: Gaussians that are not shown; None for none.
        crops: see ``crops.kept_of_all``.
        grades: applied one after the other.
        timing: for those who go through frames (see ``retimed_scene``); None for the capture's own.
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
        dropped = []
        hidden = self.hidden
        if hidden is not None and not hidden.fits(scene):
            dropped.append(_dropped("Hidden Gaussians were", hidden, scene))
            hidden = None
        grades = []
        for grade in self.grades:
            if grade.only is not None and not grade.only.fits(scene):
                dropped.append(_dropped("A grade of a selection was", grade.only, scene))
            else:
                grades.append(grade)
        if not dropped:
            return self, []
        return replace(self, hidden=hidden, grades=tuple(grades)), dropped


def _dropped(what: str, marks: Marks, scene: ScenePlayer) -> str:
    found = f"{marks.count:,} Gaussians" if marks.count != scene.file_count else "another training"
    return f"{what} dropped: made for a scene of {found}, found one of {scene.file_count:,}."
