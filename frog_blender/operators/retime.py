"""A capture in time: Timing to Curve, Fit Frame Range, and Play in Real Time."""

import math

import bpy

from ..engine.errors import FrogError
from ..scene_import.capture_objects import active_capture
from ..timeline import retiming, timing_curve
from ..ui.captures_panel import chosen_capture
from .bases import EditOperator, UndoableOperator, scene_of


class FROG_OT_timing_to_curve(EditOperator, bpy.types.Operator):
    """Make a curve of the capture's start, speed and repetition, to be edited in the Graph Editor"""

    bl_label = "Timing to Curve"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if missing := super().problem(context):
            return missing
        obj = active_capture(context)
        if _frames(obj) < 2:
            return "The capture does not move, or its file cannot be played."
        return "Time Remapping decides already." if obj.frog.use_remap else timing_curve.problem(obj)

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        scene = context.scene
        first, last = (retiming.stretched(scene, frame) for frame in (scene.frame_start, scene.frame_end))
        timing_curve.write_keys(obj, timing_curve.keys_of(obj, first, last))


class _OfChosen(UndoableOperator):
    """Base of operators on the capture that is chosen in the list, which moves."""

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        obj = chosen_capture(context)
        if obj is None or _frames(obj) < 2:
            return "The chosen capture does not move, or its file cannot be played."
        return ""


class FROG_OT_fit_frame_range(_OfChosen, bpy.types.Operator):
    """Make the scene begin and end with the chosen capture, as its Start Frame and Speed have it"""

    bl_label = "Fit Frame Range"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        missing, obj = super().problem(context), chosen_capture(context)
        if missing or retiming.playing_frames(obj, context.scene, _frames(obj)) is not None:
            return missing
        settings = obj.frog
        if settings.use_remap and retiming.shown_curve(obj) is None:
            return "Time Remapping decides when it plays."
        return "Its limits leave nothing of it." if settings.use_remap or settings.speed else "Its speed is zero."

    def act(self, context: bpy.types.Context) -> None:
        obj, scene = chosen_capture(context), context.scene
        begin, end = retiming.playing_frames(obj, scene, _frames(obj)) or (0.0, -1.0)
        first, last = max(0, math.floor(begin + 1e-4)), math.ceil(end - 1e-4)
        if last < first or last > retiming.LAST_FRAME:
            raise FrogError(f"It plays from frame {begin:,.0f} to {end:,.0f}, which no scene has.")
        scene.frame_start, scene.frame_end = first, last


class FROG_OT_play_in_real_time(_OfChosen, bpy.types.Operator):
    """Set the chosen capture's Speed so that it plays as fast as it was filmed at the scene's frame rate"""

    bl_label = "Real Time"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        is_remapped = not (missing := super().problem(context)) and chosen_capture(context).frog.use_remap
        return "Time Remapping decides when it plays." if is_remapped else missing

    def act(self, context: bpy.types.Context) -> None:
        obj = chosen_capture(context)
        obj.frog.speed = retiming.real_time_speed(context.scene, scene_of(obj).header.frames_per_second)


def _frames(obj: bpy.types.Object) -> int:
    """How many frames a capture has; 0 for a file that cannot be played."""
    try:
        return scene_of(obj).header.frame_count
    except FrogError:  # shown by the panel
        return 0
