"""A capture and the scene that plays it, found anew at each frame of an export."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ..engine.errors import FrogError
from ..scene_import.capture_objects import find_by_uid
from ..timeline import playback
from ..timeline.retiming import raw_frame


@dataclass(frozen=True)
class TimelineVisit:
    """Goes through frames of the timeline. Between two of them the .blend may change, so no object of it is kept.

    Attributes:
        capture: session_uid of the object that plays the capture.
        name: of the capture, in messages.
        scene, layer: session_uid of the scene that is gone through, and name of its view layer.
        shown: frame and subframe that the scene shows before.
    """

    capture: int
    name: str
    scene: int
    layer: str
    shown: tuple[int, float]

    @classmethod
    def of(cls, context: bpy.types.Context, obj: bpy.types.Object, name: str) -> TimelineVisit:
        """Of ``obj`` in the current scene."""
        scene = context.scene
        shown = scene.frame_current, scene.frame_subframe
        return cls(obj.session_uid, name, scene.session_uid, context.view_layer.name, shown)

    def found(self) -> tuple[bpy.types.Object, bpy.types.Scene]:
        """The object and the scene as they are now; FrogError if either is gone."""
        obj = find_by_uid(bpy.data.objects, self.capture)
        if obj is None or next(playback.captures([obj]), None) is None:
            raise FrogError(f"{self.name}: this capture is no longer in the file.")
        scene = find_by_uid(bpy.data.scenes, self.scene)
        if scene is None:
            raise FrogError(f"{self.name}: its scene was deleted during the export.")
        return obj, scene

    def evaluated_at(self, frame: float) -> tuple[bpy.types.Object, bpy.types.Scene, bpy.types.Object]:
        """As ``found``, with the scene moved to a frame, and the object as it is evaluated there."""
        obj, scene = self.found()
        if frame != raw_frame(scene):
            scene.frame_set(int(frame))  # the empty may be animated
        layer = scene.view_layers.get(self.layer) or scene.view_layers[0]
        layer.update()
        return obj, scene, obj.evaluated_get(layer.depsgraph)

    def restore(self) -> None:
        """Restores the scene's current frame, if the scene still exists."""
        scene = find_by_uid(bpy.data.scenes, self.scene)
        if scene is not None and (scene.frame_current, scene.frame_subframe) != self.shown:
            scene.frame_set(self.shown[0], subframe=self.shown[1])
