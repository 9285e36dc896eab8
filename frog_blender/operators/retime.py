"""A capture in time: Split, Timing to Curve, Play in Sequence, Fit Frame Range, and Play in Real Time."""

import math

import bpy

from ..engine.errors import FrogError
from ..scene_import.capture_objects import active_capture, root_of, select_capture
from ..timeline import playback, retiming, timing_curve
from ..ui.captures_panel import chosen_capture
from .bases import EditOperator, UndoableOperator, scene_of


class _Retimes(EditOperator):
    """Base of operators on a capture that moves."""

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        missing = super().problem(context)
        if not missing and _frames(active_capture(context)) < 2:
            return "The capture does not move, or its file cannot be played."
        return missing


class FROG_OT_split_capture(_Retimes, bpy.types.Operator):
    """Make two captures of one, which follow each other at the current frame. The file stays as it is"""

    bl_label = "Split Capture"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if missing := super().problem(context):
            return missing
        if context.mode != "OBJECT":
            return "Captures are split in Object Mode."
        obj = active_capture(context)
        first, end = _range(context.scene, obj)
        if not first < context.scene.frame_current_final < end:
            return "Go to a frame between the first and the last one at which the capture is there."
        if any(context.view_layer.objects.get(moved.name) != moved for moved in (obj, root_of(obj))):
            return "The capture is in a collection that is excluded from the view layer."
        return ""

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        frame, (first, end) = context.scene.frame_current_final, _limits(obj)
        other = _copy(obj)
        for half, start, stop in ((obj, first, frame), (other, frame, end)):
            half.frog.range_start, half.frog.range_end, half.frog.use_range = start, stop, True
        select_capture(context, other)
        return f"{root_of(other).name} goes on where {root_of(obj).name} ends."


class FROG_OT_timing_to_curve(_Retimes, bpy.types.Operator):
    """Make a curve of the capture's start, speed and repetition, to be edited in the Graph Editor"""

    bl_label = "Timing to Curve"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if missing := super().problem(context):
            return missing
        obj = active_capture(context)
        return "Time Remapping decides already." if obj.frog.use_remap else timing_curve.problem(obj)

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        scene = context.scene
        first, last = (retiming.stretched(scene, frame) for frame in (scene.frame_start, scene.frame_end))
        timing_curve.write_keys(obj, timing_curve.keys_of(obj, first, last))


class FROG_OT_play_in_sequence(EditOperator, bpy.types.Operator):
    """Let the selected captures play one after another, in the order in which they start, each alone"""

    bl_label = "Play in Sequence"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if len(_selected(context)) > 1 else "Select two captures or more of this file first."

    def edit(self, context: bpy.types.Context, _obj: bpy.types.Object) -> str:
        spans = []
        for obj in _selected(context):  # all of them before the first one is changed
            timing_curve.check_editable(obj)
            frames = _frames(obj)
            span = retiming.span(obj, frames) if frames else None
            if span is None:
                raise FrogError(f"{root_of(obj).name}: found no first and last frame that it plays, expected some.")
            spans.append((*span, obj))
        spans.sort(key=lambda span: span[:2])
        at = math.floor(spans[0][0])
        begin = at
        for first, end, obj in spans:
            timing_curve.move(obj, at - first)
            following = at + max(math.ceil(end - first - 1e-4), 1)
            obj.frog.range_start, obj.frog.range_end, obj.frog.use_range = at, following, True
            at = following
        return f"{len(spans)} captures play in frames {begin:,} to {at - 1:,}."


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


def _limits(obj: bpy.types.Object) -> tuple[float, float]:
    settings = obj.frog
    return (settings.range_start, settings.range_end) if settings.use_range else (-retiming.FAR, retiming.FAR)


def _range(scene: bpy.types.Scene, obj: bpy.types.Object) -> tuple[float, float]:
    """The frames of the timeline at which a capture is there: all of the scene's and its own, where it has no limit."""
    low, high = _limits(obj)
    first = retiming.stretched(scene, scene.frame_start)
    end = retiming.stretched(scene, scene.frame_end + 1)
    span = retiming.span(obj, max(_frames(obj), 1))
    if span is not None:
        first, end = min(first, span[0]), max(end, span[1])
    return (low if low > -retiming.FAR else first, high if high < retiming.FAR else end)


def _copy(obj: bpy.types.Object) -> bpy.types.Object:
    """Another object that plays the same file, with a root of its own."""
    root = root_of(obj)
    other = obj.copy()
    other.data = obj.data.copy()
    other.frog.sound = None  # it was made for the whole
    made = [(obj, other)]
    if root != obj:
        other_root = root.copy()
        other.parent = other_root
        other.matrix_parent_inverse = obj.matrix_parent_inverse
        made.append((root, other_root))
    for old, new in made:
        animation = new.animation_data
        if animation is not None and animation.action is not None:
            animation.action = animation.action.copy()  # so far it shares that; Blender finds its slot there
        for collection in old.users_collection:
            collection.objects.link(new)
    return other


def _selected(context: bpy.types.Context) -> list[bpy.types.Object]:
    captures = playback.captures(context.scene.objects)
    selected = set(context.selected_objects)
    return [obj for obj in captures if obj.library is None and (obj in selected or root_of(obj) in selected)]
