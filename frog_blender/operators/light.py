"""Light Objects by This Capture, and back to the scene's own world."""

import bpy

from ..lighting import world
from ..lighting.world import light_by
from ..scene_import.capture_objects import active_capture
from .bases import UndoableOperator


class FROG_OT_light_objects(UndoableOperator, bpy.types.Operator):
    """Light the objects of this scene with what the capture shows at the current frame. Cameras see the world as \
before. Press again after changes to take the light anew"""

    bl_label = "Light Objects by This Capture"
    needs_capture = True

    def act(self, context: bpy.types.Context) -> str:
        scene = world.lit_scene(context.scene)
        light_by(active_capture(context), context)
        return f"The objects of {scene.name} are lit by frame {context.scene.frame_current}."


class FROG_OT_use_own_world(UndoableOperator, bpy.types.Operator):
    """Light the objects of this scene with its own world again. What else was changed in the world while it was lit \
stays in the lit one, which the .blend then keeps"""

    bl_label = "Use My Own World"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if world.is_lit(world.lit_scene(context.scene)) else "The scene has its own world."

    def act(self, context: bpy.types.Context) -> None:
        world.restore(world.lit_scene(context.scene))
