"""Add Sound Strip, Add Speaker and Update Sound: what a capture's videos recorded, in time with the capture."""

from __future__ import annotations

import bpy

from ..scene_import import capture_sound
from ..scene_import.capture_objects import active_capture
from .edit_operator import EditOperator


class FROG_OT_add_sound_strip(EditOperator, bpy.types.Operator):
    """Put the sound of the capture's video into the sequencer, in time with the capture as it is retimed now"""

    bl_idname = "frog.add_sound_strip"
    bl_label = "Add Sound Strip"

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        made = capture_sound.place(context, obj, strip=True)
        return f"The sound is in the sequencer from frame {made.start:,} on."


class FROG_OT_add_speaker(EditOperator, bpy.types.Operator):
    """Add a speaker at the capture that plays its video's sound, in time with the capture as it is retimed now"""

    bl_idname = "frog.add_speaker"
    bl_label = "Add Speaker"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Speakers are added in Object Mode.")
            return False
        return super().poll(context)

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        made = capture_sound.place(context, obj, speaker=True)
        return f"The speaker plays from frame {made.start:,} on."


class FROG_OT_update_sound(EditOperator, bpy.types.Operator):
    """Make the sound of the capture's strip and speaker anew, as the capture is retimed now"""

    bl_idname = "frog.update_sound"
    bl_label = "Update Sound"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        obj = active_capture(context)
        cls.poll_message_set("Add a sound strip or a speaker of the capture first.")
        return obj is not None and capture_sound.sound_of(obj) is not None

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        capture_sound.place(context, obj)
        return ""


_CLASSES = (FROG_OT_add_sound_strip, FROG_OT_add_speaker, FROG_OT_update_sound)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
