"""Look Through Camera."""

# mypy: disable-error-code="valid-type"

import bpy

from ..scene_import.scene_setup import look_through


class FROG_OT_look_through(bpy.types.Operator):
    """Make the selected camera active and render at the size of its captured images"""

    bl_idname = "frog.look_through"
    bl_label = "Look Through Camera"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Select a camera first.")
        return context.object is not None and context.object.type == "CAMERA"

    def execute(self, context: bpy.types.Context) -> set[str]:
        look_through(context.scene, context.object)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((FROG_OT_look_through,))
