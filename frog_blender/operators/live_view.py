"""The live scene of a training: look through a camera of its rig and back, choose that camera, attach it elsewhere."""

import bpy

from ..registration import Keys
from ..tasks.training import TrainingTask
from ..ui.rig_overlay import camera_at
from ..viewport import live, views
from .bases import FrogOperator

KEY = "NUMPAD_0"
"""Blender's own for cameras, which it keeps for itself where no training is seen."""


class FROG_OT_look_live(FrogOperator, bpy.types.Operator):
    """Look at the training's scene through the preview's camera, or back to the view of before"""

    bl_label = "Through the Rig's Camera"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if not isinstance(context.space_data, bpy.types.SpaceView3D):
            return "Look at a viewport first."
        seen = live.seen_in(context.scene)
        can_look = seen is not None and seen.cameras
        return "" if can_look or views.is_through(context.space_data) else "No training is seen in this scene."

    def act(self, context: bpy.types.Context) -> None:
        seen = live.seen_in(context.scene)
        if seen is None or views.is_through(context.space_data):
            views.back(context.space_data)
        else:
            live.look(context.area, seen, context.scene.frog.preview_camera)


class FROG_OT_pick_camera(FrogOperator, bpy.types.Operator):
    """Choose the camera of the rig under the mouse for the training's preview"""

    bl_label = "Choose Preview Camera"
    bl_options = {"INTERNAL"}

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        is_viewport = context.region_data is not None and context.region.type == "WINDOW"
        can_pick = is_viewport and TrainingTask.is_any_running()
        return "" if can_pick else "Only while a training runs, in a viewport."

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        name = camera_at(context, (event.mouse_region_x, event.mouse_region_y))
        if not name:
            return {"PASS_THROUGH"}
        context.scene.frog.preview_camera = name
        context.area.tag_redraw()
        return {"FINISHED"}


class FROG_OT_show_live_here(FrogOperator, bpy.types.Operator):
    """Show the scene of the running training in this scene's viewports"""

    bl_label = "Show It Here"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if live.elsewhere(context.scene) else "No training is shown elsewhere."

    def act(self, context: bpy.types.Context) -> None:
        live.show_here(context.scene)


KEYMAPS: Keys = [
    ("3D View", FROG_OT_look_live.bl_idname, KEY, "PRESS", {}),
    ("Object Mode", FROG_OT_pick_camera.bl_idname, "LEFTMOUSE", "CLICK", {}),
]
