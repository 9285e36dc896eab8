"""The curve of a capture's Shown Frame, for the Graph Editor: made of its simpler settings or given keys."""

import math

import bpy

from ..engine.errors import FrogError
from . import playback
from .retiming import REMAPPED, capture_frame, needs_evaluated_time, piece, shown_curve

_MOST_KEYS = 10_000
_SOON = 0.05  # frames after which a loop that plays backward is at its end again


def problem(obj: bpy.types.Object) -> str:
    """Why a capture's time cannot be edited by its curve, or an empty string."""
    if needs_evaluated_time(obj):
        return "Its time is driven, in the NLA, or animated by other settings."
    curve = shown_curve(obj)
    if curve is not None and curve.modifiers:
        return "The curve of its Shown Frame has modifiers."
    return ""


def check_editable(obj: bpy.types.Object) -> None:
    """FrogError for a capture whose time cannot be edited by its curve."""
    why = problem(obj)
    if why:
        raise FrogError(f"{obj.name}: found a time that cannot be edited, expected settings or a curve. {why}")


def keys_of(obj: bpy.types.Object, first: float, last: float) -> list[tuple[float, float, str]]:
    """Frame, value and interpolation of the keys that play as start, speed, repetition and trim do.

    Args:
        first, last: frames of the timeline within which repetitions become keys.

    Raises:
        FrogError: for too many repetitions, or settings that are no numbers.
    """
    settings, frames = obj.frog, playback.open_scene(playback.file_of(obj)).header.frame_count
    begin, count = piece(settings, frames)
    start, speed = settings.start_frame, settings.speed
    capture_frame(obj, start, frames)  # raises for what is no number
    if not speed or count < 2:
        return [(first, capture_frame(obj, first, frames), "LINEAR")]
    if settings.repeat == "HOLD":
        ends = [(start, float(begin)), (start + (count - 1) / speed, begin + count - 1.0)]
        return [(frame, value, "LINEAR") for frame, value in sorted(ends)]
    is_loop = settings.repeat == "LOOP"
    length = (count if is_loop else count - 1) / abs(speed)
    if (last - first) / length > _MOST_KEYS / 2:
        raise FrogError(f"{obj.name}: found more than {_MOST_KEYS:,} repetitions, expected a shorter range of frames.")
    keys: list[tuple[float, float, str]] = []
    for turn in range(math.floor((first - start) / length), math.ceil((last - start) / length) + 1):
        at = start + turn * length
        if is_loop:
            shown = (count - 1) / abs(speed)
            low, high = float(begin), begin + count - 1.0
            # One frame of the capture after its last one the first one is shown again: at once.
            if speed > 0:
                keys += [(at, low, "LINEAR"), (at + shown, high, "CONSTANT")]
            else:
                keys += [(at, low, "CONSTANT"), (at + _SOON, high, "CONSTANT"), (at + length - shown, high, "LINEAR")]
        else:
            keys.append((at, float(begin if turn % 2 == 0 else begin + count - 1), "LINEAR"))
    return keys


def write_keys(obj: bpy.types.Object, keys: list[tuple[float, float, str]]) -> None:
    """Makes keys (frame, value, interpolation) the whole curve of the Shown Frame, which decides from now on.

    Raises:
        FrogError: for a curve that is muted.
    """
    old = shown_curve(obj)
    if old is not None:
        old.keyframe_points.clear()
    obj.keyframe_insert(REMAPPED, frame=keys[0][0])  # makes the curve, whatever holds curves in this Blender
    curve = shown_curve(obj)
    if curve is None:
        raise FrogError(f"{obj.name}: its Shown Frame could not be keyed, expected a curve that is not muted.")
    points = curve.keyframe_points
    points.add(len(keys) - len(points))
    for point, (frame, value, interpolation) in zip(points, keys, strict=True):
        point.co = frame, value
        point.interpolation = interpolation
        point.handle_left_type = point.handle_right_type = "VECTOR"
    curve.extrapolation = "CONSTANT"
    curve.update()
    obj.frog.use_remap = True
