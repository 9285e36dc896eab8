"""Exports frames of a capture to files of other programs, one at a time."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..capture_files import file_of
from ..engine.errors import FrogError
from ..timeline import playback
from ..timeline.retiming import stretched
from .timeline_visit import TimelineVisit

if TYPE_CHECKING:
    from ..engine.gaussians import GaussianArrays


@dataclass
class FrameExport:
    """An export in progress.

    Attributes:
        visit: finds the capture at each frame.
        frames: of the timeline; ``paths`` their files.
        turn: (4, 4) from Blender's axes to those of the files, if the Gaussians are written where the capture has been
            placed; None to leave them in the capture's own space, which mostly needs no other frame to be shown.
        spz_version: see ``interchange.frame_files.write_frame``.
    """

    visit: TimelineVisit
    frames: list[float]
    paths: list[Path]
    turn: np.ndarray | None
    spz_version: int = 3

    @classmethod
    def of(
        cls,
        context: bpy.types.Context,
        obj: bpy.types.Object,
        frames: list[float],
        paths: list[Path],
        turn: np.ndarray | None,
    ) -> FrameExport:
        """An export of what ``obj`` shows in the current scene."""
        return cls(TimelineVisit.of(context, obj, obj.name), frames, paths, turn)

    def steps(self) -> Generator[int, None, None]:
        """Writes one file per step, atomically, and yields the number of files written; raises FrogError."""
        from ..engine.interchange.frame_files import write_frame

        obj, _ = self.visit.found()
        promise = len(self.paths) > 1 and playback.open_scene(file_of(obj)).keeps_identity
        for done, (frame, path) in enumerate(zip(self.frames, self.paths, strict=True), 1):
            write_frame(path, self._gaussians(frame), promise=promise, spz_version=self.spz_version)
            yield done

    def restore(self) -> None:
        """See TimelineVisit."""
        self.visit.restore()

    def _gaussians(self, frame: float) -> GaussianArrays:
        from ..engine.playback.transform import transform

        obj, scene = self.visit.found()
        if self.turn is None and not playback.needs_evaluation(obj):
            return playback.gaussians_at(obj, stretched(scene, frame))
        obj, scene, evaluated = self.visit.evaluated_at(frame)
        gaussians = playback.gaussians_at(obj, scene.frame_current_final, evaluated)
        if self.turn is None:
            return gaussians
        try:
            return transform(gaussians, self.turn @ np.array(evaluated.matrix_world))
        except FrogError as error:
            reason = str(error).rstrip(".")
            raise FrogError(f"{obj.name}: {reason}, or be exported without Apply Transform.") from error
