"""Maps frames of the timeline to frames of a capture: start, speed, repetition, a piece of it, or a user's curve."""

import math
from collections.abc import Iterator
from itertools import chain
from typing import Any

import bpy
from bpy_extras.anim_utils import action_get_channelbag_for_slot

from ..engine.errors import FrogError
from ..engine.scene.header import SceneHeader

REMAPPED = "frog.shown_frame"
"""The property whose curve is read directly: frame handlers run before Blender evaluates animation."""
TIMING = ("frog.start_frame", "frog.speed", "frog.repeat", "frog.use_remap", REMAPPED)
"""All properties that affect the shown frame and can be animated."""
LAST_FRAME = 1_048_574
"""The last frame of any timeline of Blender's."""
_ROUNDING = 1e-3  # frames: what numbers of single precision lose


class BadTiming(FrogError):
    """A setting that determines the shown frame is not a finite number, due to a file, a driver or a curve."""


def capture_frame(
    obj: bpy.types.Object, scene_frame: float, frame_count: int, evaluated: bpy.types.Object | None = None
) -> float:
    """The capture's frame, counted from 0 (fractions are legal; outside of 0 and the last one it is held).

    Args:
        obj: what plays the capture; its ``frog`` settings decide.
        scene_frame: of the timeline, may be fractional.
        frame_count: of the capture.
        evaluated: the object as a depsgraph has it at that frame, where one was evaluated.

    Raises:
        BadTiming: for settings that lead to no frame.
    """
    settings = obj.frog if evaluated is None else evaluated.frog
    if settings.use_remap:
        curve = shown_curve(obj) if evaluated is None else None
        return _finite(curve.evaluate(scene_frame) if curve is not None else settings.shown_frame, obj, "Shown Frame")
    position = _finite((scene_frame - settings.start_frame) * settings.speed, obj, "Start Frame or Speed")
    first, count = piece(settings, frame_count)
    played = repeated(position, settings.repeat, count)
    return first + min(max(played, 0.0), count - 1.0) if settings.use_trim else played


def piece(settings: Any, frame_count: int) -> tuple[int, int]:
    """The first frame of a capture that is played, and how many are: all of them, where it is not trimmed."""
    if not settings.use_trim:
        return 0, frame_count
    first = min(max(settings.first_frame, 0), frame_count - 1)
    return first, min(max(settings.last_frame, first), frame_count - 1) - first + 1


def is_shown(obj: bpy.types.Object, scene_frame: float) -> bool:
    """Whether a capture is there at a frame of the timeline: not before and after a range that it was given."""
    settings = obj.frog
    if not settings.use_range:
        return True
    return bool(settings.range_start - _ROUNDING <= scene_frame < settings.range_end - _ROUNDING)


def within_range(obj: bpy.types.Object, scene_frame: float) -> float:
    """A frame of the timeline, held at the ends of the range in which a capture is there."""
    settings = obj.frog
    return min(max(scene_frame, settings.range_start), settings.range_end) if settings.use_range else scene_frame


def playing_frames(obj: bpy.types.Object, scene: bpy.types.Scene, frame_count: int) -> tuple[float, float] | None:
    """The frames of a scene's timeline at which a capture's first and last frame are shown once, the earlier first, as
    far as it is there; under a remapped time, those of the curve's first and last key. None where no such frames are
    known: for a remapped time without a curve, without speed or for settings that are no numbers.
    """
    ends = _ends(obj, frame_count)
    if ends is None:
        return None
    first, last = min(ends), max(ends)
    if obj.frog.use_range:
        first, last = max(first, obj.frog.range_start), min(last, obj.frog.range_end - stretched(scene, 1))
    return (first / stretched(scene, 1), last / stretched(scene, 1)) if first <= last else None


def _ends(obj: bpy.types.Object, frame_count: int) -> tuple[float, float] | None:
    """The frames of the timeline, without Time Stretching, at which a capture begins and ends, in whatever order;
    None where these are not known."""
    settings = obj.frog
    if settings.use_remap:
        curve = shown_curve(obj)
        if curve is None or not len(curve.keyframe_points):
            return None
        ends = curve.keyframe_points[0].co.x, curve.keyframe_points[-1].co.x
    elif settings.speed:
        _, count = piece(settings, frame_count)
        ends = settings.start_frame, settings.start_frame + (count - 1) / settings.speed
    else:
        return None
    return ends if all(map(math.isfinite, ends)) else None


def frame_rate(scene: bpy.types.Scene) -> float:
    """Frames a second of a scene's timeline."""
    return scene.render.fps / scene.render.fps_base


def real_time_speed(scene: bpy.types.Scene, frames_per_second: float) -> float:
    """The speed with which a capture of that rate plays as fast as it was filmed."""
    return frames_per_second / frame_rate(scene) / stretched(scene, 1)


def other_rate(scene: bpy.types.Scene, header: SceneHeader) -> str:
    """What is to be said of a capture that a scene of another rate plays; "" of the same."""
    if header.frame_count < 2 or math.isclose(real_time_speed(scene, header.frames_per_second), 1.0, rel_tol=1e-3):
        return ""
    return (
        f"It was filmed at {header.frames_per_second:g} frames a second, and the scene plays {frame_rate(scene):g}: "
        "use Real Time in its timing."
    )


def problem(obj: bpy.types.Object, scene_frame: float) -> str:
    """Why a capture has no frame to show at a frame of the timeline, or an empty string."""
    try:
        capture_frame(obj, scene_frame, 1)
    except BadTiming as error:
        return str(error)
    return ""


def _finite(frame: float, obj: bpy.types.Object, name: str) -> float:
    if not math.isfinite(frame):
        raise BadTiming(f"{obj.name}: {name} is not a number. The capture stays at its current frame.")
    return frame


def repeated(position: float, repeat: str, frame_count: int) -> float:
    """Maps a position on the capture's time axis, in frames, into its range.

    "HOLD" leaves it as it is, "LOOP" begins again one frame after the last, "PING_PONG" turns around at the ends.
    """
    last = frame_count - 1
    if repeat == "HOLD" or last < 1:
        return position
    if repeat == "LOOP":
        return math.fmod(math.fmod(position, frame_count) + frame_count, frame_count)
    turn = math.fmod(math.fmod(position, 2 * last) + 2 * last, 2 * last)
    return turn if turn <= last else 2 * last - turn


def raw_frame(scene: bpy.types.Scene) -> float:
    """The current frame of a scene, including the subframe, as ``frame_set`` takes it."""
    return scene.frame_current + scene.frame_subframe


def stretched(scene: bpy.types.Scene, frame: float) -> float:
    """A frame after Blender's Time Stretching: ``frame_current_final`` if the scene is at that frame."""
    return frame * scene.render.frame_map_old / scene.render.frame_map_new


def needs_evaluated_time(obj: bpy.types.Object) -> bool:
    """Whether the shown frame depends on drivers, the NLA or curves of other settings, and so on Blender's
    evaluation of the frame.
    """
    animation = obj.animation_data
    if animation is None:
        return False
    others = (curve for curve in curves(animation) if curve.data_path != REMAPPED)
    return any(curve.data_path in TIMING for curve in chain(animation.drivers, others, strip_curves(animation)))


def is_plain(settings: Any, scene: bpy.types.Scene) -> bool:
    """Whether a capture plays frame by frame in a scene, wherever it begins."""
    simple = not (settings.use_remap or settings.use_trim or settings.use_range)
    return bool(simple and settings.speed == 1 and settings.repeat == "HOLD" and stretched(scene, 1) == 1)


def shown_curve(obj: bpy.types.Object) -> bpy.types.FCurve | None:
    """The curve of ``REMAPPED`` if nothing else animates the shown frame, or None."""
    animation = obj.animation_data
    if animation is None or needs_evaluated_time(obj):
        return None
    return next((curve for curve in curves(animation) if curve.data_path == REMAPPED), None)


def curves(animation: bpy.types.AnimData | bpy.types.NlaStrip) -> Iterator[bpy.types.FCurve]:
    """The curves of its action that are not muted."""
    bag = action_get_channelbag_for_slot(animation.action, animation.action_slot)
    for curve in bag.fcurves if bag is not None else ():
        if not curve.mute and not (curve.group is not None and curve.group.mute):
            yield curve


def strip_curves(animation: bpy.types.AnimData) -> Iterator[bpy.types.FCurve]:
    """The curves of the actions in the NLA, if that is used."""
    strips = [strip for track in animation.nla_tracks for strip in track.strips] if animation.use_nla else []
    for strip in strips:  # which grows by what is in meta strips
        strips.extend(strip.strips)
        yield from curves(strip)


def animated_paths(block: bpy.types.ID) -> list[str]:
    """Paths of all properties of a data-block that curves, strips of the NLA and drivers animate."""
    animation = block.animation_data
    if animation is None:
        return []
    return [curve.data_path for curve in chain(animation.drivers, curves(animation), strip_curves(animation))]
