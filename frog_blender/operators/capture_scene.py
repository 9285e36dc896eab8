"""A capture from the open scene: places a rig, renders through it in the background, and opens what was rendered."""

# mypy: disable-error-code="valid-type"

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
from bpy.props import BoolProperty

from ..engine.errors import FrogError
from ..scene_capture import placing
from ..scene_capture.request import request_of
from ..scene_import.capture_objects import finder
from ..tasks.scene_capture import SceneCaptureTask
from .cancel_operator import CancelsTask


class FROG_OT_place_rig(bpy.types.Operator):
    """Place cameras around the box, in a collection of their own. Around the selected objects if there is no box yet"""

    bl_idname = "frog.place_rig"
    bl_label = "Place Cameras"
    bl_options = {"REGISTER", "UNDO"}

    fit: BoolProperty(
        name="Fit to Selection",
        description="Move the box around the selected objects first, wherever they are over the scene's frames",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Only in Object Mode.")
        return context.mode == "OBJECT"

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene, settings = context.scene, context.scene.frog.rig
        try:
            if self.fit or settings.box is None:
                placing.fit_box(scene, context.view_layer, settings)
            cameras = placing.place(scene, settings)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Placed {len(cameras):,} cameras around {settings.box.name}.")
        return {"FINISHED"}


class FROG_OT_remove_rig(bpy.types.Operator):
    """Delete the rig's cameras and box. What was rendered stays"""

    bl_idname = "frog.remove_rig"
    bl_label = "Remove Rig"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.mode == "OBJECT" and context.scene.frog.rig.collection is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        placing.remove(context.scene.frog.rig)
        return {"FINISHED"}


class FROG_OT_capture_scene(bpy.types.Operator):
    """Render the scene's frames through the rig, in a Blender beside this one, as a capture to train from. This scene \
and its settings stay as they are"""

    bl_idname = "frog.capture_scene"
    bl_label = "Render Capture"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not placing.cameras_of(context.scene.frog.rig):
            cls.poll_message_set("There are no cameras yet. Press Place Cameras.")
            return False
        cls.poll_message_set("A scene is being rendered already.")
        return not SceneCaptureTask.is_any_running()

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            request = request_of(context.scene, context.scene.frog.rig)
            SceneCaptureTask(request, partial(_open, finder(context.scene))).begin()
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_cancel_scene_capture(CancelsTask, bpy.types.Operator):
    """Stop rendering. Images that are done are kept, and the next rendering continues there"""

    bl_idname = "frog.cancel_scene_capture"
    bl_label = "Cancel"

    kind = SceneCaptureTask


def _open(find: Callable[[], bpy.types.Scene | None], folder: Path) -> None:
    """Shows the capture in the Capture panel of the scene that it was rendered from, which Train then trains."""
    found = find()
    if found is not None:
        found.frog.capture_folder = str(folder)


_CLASSES = (FROG_OT_place_rig, FROG_OT_remove_rig, FROG_OT_capture_scene, FROG_OT_cancel_scene_capture)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
