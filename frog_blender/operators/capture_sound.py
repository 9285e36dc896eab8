"""Add Sound Strip, Add Speaker and Update Sound: what a capture's videos recorded, in time with the capture."""

import bpy

from ..scene_import import capture_sound
from ..scene_import.capture_objects import active_capture
from .bases import EditOperator


class FROG_OT_add_sound_strip(EditOperator, bpy.types.Operator):
    """Put the sound of the capture's video into the sequencer, in time with the capture as it is retimed now"""

    bl_label = "Add Sound Strip"

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        made = capture_sound.place(context, obj, strip=True)
        return f"The sound is in the sequencer from frame {made.start:,} on."


class FROG_OT_add_speaker(EditOperator, bpy.types.Operator):
    """Add a speaker at the capture that plays its video's sound, in time with the capture as it is retimed now"""

    bl_label = "Add Speaker"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return super().problem(context) if context.mode == "OBJECT" else "Speakers are added in Object Mode."

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        made = capture_sound.place(context, obj, speaker=True)
        return f"The speaker plays from frame {made.start:,} on."


class FROG_OT_update_sound(EditOperator, bpy.types.Operator):
    """Make the sound of the capture's strip and speaker anew, as the capture is retimed now"""

    bl_label = "Update Sound"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        missing = super().problem(context)
        if not missing and capture_sound.sound_of(active_capture(context)) is None:
            return "Add a sound strip or a speaker of the capture first."
        return missing

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        capture_sound.place(context, obj)
