"""A capture as the timeline plays it, for other programs: retimed, and where its root stands at each frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..engine.interchange.take import Sound, TakeFrame
from ..timeline import playback
from ..timeline.edits import needs_evaluation
from ..timeline.retiming import frame_rate, is_shown, stretched
from .timeline_visit import TimelineVisit

if TYPE_CHECKING:
    from ..engine.scene.header import SceneHeader


@dataclass
class TimelineTake:
    """Frames of the timeline as a ``Take``.

    Attributes:
        visit: finds the capture at each frame.
        numbers: frames of the timeline.
        rate: frames a second.
        header, num_dynamic, changing: of the capture (see ``Take``).
        keeps_identity: see ``Take``.
        placed: whether the Gaussians stand where the capture has been placed; else in the capture's own space.
        sound: what plays with it.
    """

    visit: TimelineVisit
    numbers: Sequence[float]
    rate: float
    header: SceneHeader
    num_dynamic: int
    changing: Sequence[str]
    keeps_identity: bool
    placed: bool
    sound: Sound | None = None

    @classmethod
    def of(
        cls, context: bpy.types.Context, obj: bpy.types.Object, numbers: Sequence[float], *, placed: bool
    ) -> TimelineTake:
        """What ``obj`` shows in the current scene; FrogError if its file cannot be played."""
        scene, playing = context.scene, playback.scene_time(obj, numbers[0]).scene
        several = len(numbers) > 1
        appears = len({is_shown(obj, stretched(scene, number)) for number in numbers}) > 1
        all_change = needs_evaluation(obj) or appears  # edits that are animated, and where it is not there
        return cls(
            visit=TimelineVisit.of(context, obj, obj.parent.name if obj.parent is not None else obj.name),
            numbers=numbers,
            rate=frame_rate(scene),
            header=playing.header,
            num_dynamic=(playing.count if all_change else playing.num_dynamic) if several else 0,
            changing=(playing.columns if all_change else playing.changing) if several else (),
            keeps_identity=playing.keeps_identity,
            placed=placed,
        )

    @property
    def name(self) -> str:
        """Of the capture."""
        return self.visit.name

    def frames(self) -> Iterator[TakeFrame]:
        """Each frame, in order; the scene is moved to it."""
        for number in self.numbers:
            obj, scene, evaluated = self.visit.evaluated_at(number)
            time = playback.shown_frame(obj, scene.frame_current_final, evaluated)
            gaussians = playback.gaussians_at(obj, scene.frame_current_final, evaluated)
            placement = np.array(evaluated.matrix_world) if self.placed else None
            yield TakeFrame(number, time, gaussians, placement)

    def restore(self) -> None:
        """See TimelineVisit."""
        self.visit.restore()
