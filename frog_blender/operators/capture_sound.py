"""Add Sound Strip and Update Sound: what a capture's videos recorded, in time with the capture."""

import bpy

from ..scene_import import capture_sound
from ..scene_import.capture_objects import active_capture
from .bases import EditOperator


class FROG_OT_add_sound_strip(EditOperator, bpy.types.Operator):
    """Put the sound of the capture's video into the sequencer, in time with the capture as it is retimed now"""

    bl_label = "Add Sound Strip"

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        made = capture_sound.place(context.scene, obj)
        return f"The sound is in the sequencer from frame {made.start:,} on."


class FROG_OT_update_sound(EditOperator, bpy.types.Operator):
    """Make the sound of the capture's strip anew, as the capture is retimed now"""

    bl_label = "Update Sound"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        missing = super().problem(context)
        if not missing and capture_sound.sound_of(active_capture(context)) is None:
            return "Add a sound strip of the capture first."
        return missing

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        capture_sound.place(context.scene, obj)
