"""A capture from the open scene: places a rig, renders through it in the background, and opens what was rendered."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy

from ..properties import switch
from ..scene_capture import placing
from ..scene_capture.request import request_of
from ..scene_import.capture_objects import finder
from ..tasks.scene_capture import SceneCaptureTask
from .bases import FrogOperator, TaskOperator, UndoableOperator


class FROG_OT_place_rig(UndoableOperator, bpy.types.Operator):
    """Place cameras around the box, in a collection of their own. Around the selected objects if there is no box yet"""

    bl_label = "Place Cameras"

    fit: switch(
        "Fit to Selection",
        "Move the box around the selected objects first, wherever they are over the scene's frames",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if context.mode == "OBJECT" else "Only in Object Mode."

    def act(self, context: bpy.types.Context) -> str:
        scene, settings = context.scene, context.scene.frog.rig
        if self.fit or settings.box is None:
            placing.fit_box(scene, context.view_layer, settings)
        cameras = placing.place(scene, settings)
        return f"Placed {len(cameras):,} cameras around {settings.box.name}."


class FROG_OT_remove_rig(UndoableOperator, bpy.types.Operator):
    """Delete the rig's cameras and box. What was rendered stays"""

    bl_label = "Remove Rig"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        has_rig = context.mode == "OBJECT" and context.scene.frog.rig.collection is not None
        return "" if has_rig else "There is no rig, or the scene is not in Object Mode."

    def act(self, context: bpy.types.Context) -> None:
        placing.remove(context.scene.frog.rig)


class FROG_OT_capture_scene(FrogOperator, bpy.types.Operator):
    """Render the scene's frames through the rig, in a Blender beside this one, as a capture to train from. This scene \
and its settings stay as they are"""

    bl_label = "Render Capture"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if not placing.cameras_of(context.scene.frog.rig):
            return "There are no cameras yet. Press Place Cameras."
        return "A scene is being rendered already." if SceneCaptureTask.is_any_running() else ""

    def act(self, context: bpy.types.Context) -> None:
        find = finder(context.scene)

        def show(folder: Path) -> None:
            """In the Capture panel of the scene that was rendered, which Train then trains."""
            if (scene := find()) is not None:
                scene.frog.capture_folder = str(folder)

        SceneCaptureTask(request_of(context.scene, context.scene.frog.rig), show).begin()


class FROG_OT_cancel_scene_capture(TaskOperator, bpy.types.Operator):
    """Stop rendering. Images that are done are kept, and the next rendering continues there"""

    kind = SceneCaptureTask
