"""Fit Frame Range, and Play in Real Time."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import bpy

from ..engine.errors import FrogError
from ..timeline import playback, retiming
from ..ui.capture_list import chosen_capture

if TYPE_CHECKING:
    from ..engine.scene.header import SceneHeader

_NONE = "The chosen capture does not move, or its file cannot be played."


def _moving(context: bpy.types.Context) -> tuple[bpy.types.Object, SceneHeader] | None:
    """The chosen capture and its header, if it moves."""
    chosen = chosen_capture(context)
    try:
        header = playback.open_scene(playback.file_of(chosen)).header if chosen is not None else None
    except FrogError:  # shown by the panel
        return None
    return None if chosen is None or header is None or header.frame_count < 2 else (chosen, header)


def _unknown(obj: bpy.types.Object) -> str:
    """Why it is not known when a capture plays, if it is not."""
    settings = obj.frog
    if settings.use_remap and retiming.shown_curve(obj) is None:
        return "Time Remapping decides when it plays."
    return "Its limits leave nothing of it." if settings.use_remap or settings.speed else "Its speed is zero."


class FROG_OT_fit_frame_range(bpy.types.Operator):
    """Make the scene begin and end with the chosen capture, as its Start Frame and Speed have it"""

    bl_idname = "frog.fit_frame_range"
    bl_label = "Fit Frame Range"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        found = _moving(context)
        if found is None:
            cls.poll_message_set(_NONE)
            return False
        cls.poll_message_set(_unknown(found[0]))
        return retiming.playing_frames(found[0], context.scene, found[1].frame_count) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        found, scene = _moving(context), context.scene
        frames = None if found is None else retiming.playing_frames(found[0], scene, found[1].frame_count)
        if frames is None:
            return {"CANCELLED"}
        first, last = max(0, math.floor(frames[0] + 1e-4)), math.ceil(frames[1] - 1e-4)
        if last < first or last > retiming.LAST_FRAME:
            self.report({"ERROR"}, f"It plays from frame {frames[0]:,.0f} to {frames[1]:,.0f}, which no scene has.")
            return {"CANCELLED"}
        scene.frame_start, scene.frame_end = first, last
        return {"FINISHED"}


class FROG_OT_play_in_real_time(bpy.types.Operator):
    """Set the chosen capture's Speed so that it plays as fast as it was filmed at the scene's frame rate"""

    bl_idname = "frog.play_in_real_time"
    bl_label = "Real Time"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        found = _moving(context)
        cls.poll_message_set("Time Remapping decides when it plays." if found is not None else _NONE)
        return found is not None and not found[0].frog.use_remap

    def execute(self, context: bpy.types.Context) -> set[str]:
        found = _moving(context)
        if found is None:
            return {"CANCELLED"}
        found[0].frog.speed = retiming.real_time_speed(context.scene, found[1].frames_per_second)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((FROG_OT_fit_frame_range, FROG_OT_play_in_real_time))
