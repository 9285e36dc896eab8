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
from ..scene_import.capture_objects import find_by_uid
from ..timeline import playback
from ..timeline.retiming import raw_frame, stretched

if TYPE_CHECKING:
    from ..engine.gaussians import GaussianArrays


@dataclass
class FrameExport:
    """An export in progress. Between two frames the .blend may change, so no object of it is kept.

    Attributes:
        capture, name: session_uid and name of the object that plays the capture.
        scene, layer: session_uid of the scene that is gone through, and name of its view layer.
        shown: frame and subframe that the scene shows before.
        frames: of the timeline; ``paths`` their files.
        turn: (4, 4) from Blender's axes to those of the files, if the Gaussians are written where the capture has been
            placed; None to leave them in the capture's own space, which mostly needs no other frame to be shown.
    """

    capture: int
    name: str
    scene: int
    layer: str
    shown: tuple[int, float]
    frames: list[float]
    paths: list[Path]
    turn: np.ndarray | None

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
        scene = context.scene
        shown = scene.frame_current, scene.frame_subframe
        layer = context.view_layer.name
        return cls(obj.session_uid, obj.name, scene.session_uid, layer, shown, frames, paths, turn)

    def steps(self) -> Generator[int, None, None]:
        """Writes one file per step, atomically, and yields the number of files written; raises FrogError."""
        from ..engine.interchange.splats import write_frame

        for done, (frame, path) in enumerate(zip(self.frames, self.paths, strict=True), 1):
            gaussians = self._gaussians(frame)
            write_frame(path, gaussians, promise=len(self.paths) > 1 and self._keeps_identity())
            yield done

    def _keeps_identity(self) -> bool:
        return playback.open_scene(file_of(find_by_uid(bpy.data.objects, self.capture))).keeps_identity

    def restore(self) -> None:
        """Restores the scene's current frame, if the scene still exists."""
        scene = find_by_uid(bpy.data.scenes, self.scene)
        if scene is not None and (scene.frame_current, scene.frame_subframe) != self.shown:
            scene.frame_set(self.shown[0], subframe=self.shown[1])

    def _gaussians(self, frame: float) -> GaussianArrays:
        from ..engine.playback.transform import transform

        obj = find_by_uid(bpy.data.objects, self.capture)
        if obj is None or next(playback.captures([obj]), None) is None:
            raise FrogError(f"{self.name}: this capture is no longer in the file.")
        scene = find_by_uid(bpy.data.scenes, self.scene)
        if scene is None:
            raise FrogError(f"{self.name}: its scene was deleted during the export.")
        if self.turn is None and not playback.needs_evaluation(obj):
            return playback.gaussians_at(obj, stretched(scene, frame))
        if frame != raw_frame(scene):
            scene.frame_set(int(frame))  # the empty may be animated
        layer = scene.view_layers.get(self.layer) or scene.view_layers[0]
        layer.update()
        evaluated = obj.evaluated_get(layer.depsgraph)
        gaussians = playback.gaussians_at(obj, scene.frame_current_final, evaluated)
        if self.turn is None:
            return gaussians
        try:
            return transform(gaussians, self.turn @ np.array(evaluated.matrix_world))
        except FrogError as error:
            reason = str(error).rstrip(".")
            raise FrogError(f"{obj.name}: {reason}, or be exported without Apply Transform.") from error
