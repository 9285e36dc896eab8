"""Light Objects by This Capture, and back to the scene's own world."""

# mypy: disable-error-code="valid-type"

import bpy
import numpy as np

from ..lighting import world
from ..lighting.world import WIDTH, light_by
from ..properties import choice
from ..scene_import.capture_objects import active_capture
from .bases import UndoableOperator

_WIDTHS = ("128", "256", "512", "1024", "2048", "4096")


class FROG_OT_light_objects(UndoableOperator, bpy.types.Operator):
    """Light the objects of this scene with what the capture shows at the current frame. Cameras see the world as \
before. Press again after changes to take the light anew"""

    bl_label = "Light Objects by This Capture"
    needs_capture = True

    place: choice(
        "Taken From",
        "Where the light is taken",
        (
            ("MIDDLE", "Capture's Middle", "The place nearest the middle of the capture that nothing stands close to"),
            ("CURSOR", "3D Cursor", "The place of the 3D cursor"),
        ),
    )
    width: choice(
        "Width",
        "Pixels of the environment image. More of them make sharper reflections and a larger .blend",
        tuple((width, width, f"{width} x {int(width) // 2} pixels") for width in _WIDTHS),
        str(WIDTH),
    )

    def act(self, context: bpy.types.Context) -> str:
        scene = world.lit_scene(context.scene)
        cursor = np.array(context.scene.cursor.location, np.float64) if self.place == "CURSOR" else None
        light_by(active_capture(context), context, cursor, int(self.width))
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
