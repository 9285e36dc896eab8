"""Maps frames of the timeline to frames of a capture: start, speed, repetition or a user's curve."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..engine.errors import FrogError

if TYPE_CHECKING:
    import bpy

REMAPPED = "frog.shown_frame"
"""The property whose curve is read directly: frame handlers run before Blender evaluates animation."""
TIMING = ("frog.start_frame", "frog.speed", "frog.repeat", "frog.use_remap", REMAPPED)
"""All properties that affect the shown frame."""


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
        curve = _curve(obj) if evaluated is None else None
        return _finite(curve.evaluate(scene_frame) if curve is not None else settings.shown_frame, obj, "Shown Frame")
    position = (scene_frame - settings.start_frame) * settings.speed
    return repeated(_finite(position, obj, "Start Frame or Speed"), settings.repeat, frame_count)


def playing_frames(obj: bpy.types.Object, scene: bpy.types.Scene, frame_count: int) -> tuple[float, float] | None:
    """The frames of a scene's timeline at which a capture's first and last frame are shown once, the earlier first;
    None where no such frames are known: under a remapped time, without speed or for settings that are no numbers.
    """
    settings = obj.frog
    if settings.use_remap or not settings.speed:
        return None
    ends = settings.start_frame, settings.start_frame + (frame_count - 1) / settings.speed
    stretch = scene.render.frame_map_new / scene.render.frame_map_old
    return (min(ends) * stretch, max(ends) * stretch) if all(map(math.isfinite, ends)) else None


def real_time_speed(scene: bpy.types.Scene, frames_per_second: float) -> float:
    """The speed with which a capture of that rate plays as fast as it was filmed."""
    stretch = scene.render.frame_map_new / scene.render.frame_map_old
    return frames_per_second * scene.render.fps_base / scene.render.fps * stretch


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
    if any(driver.data_path in TIMING for driver in animation.drivers):
        return True
    if any(curve.data_path in TIMING and curve.data_path != REMAPPED for curve in curves(animation)):
        return True
    return any(curve.data_path in TIMING for curve in strip_curves(animation))


def _curve(obj: bpy.types.Object) -> bpy.types.FCurve | None:
    """The curve of ``REMAPPED`` if nothing else animates the shown frame, or None."""
    animation = obj.animation_data
    if animation is None or needs_evaluated_time(obj):
        return None
    return next((curve for curve in curves(animation) if curve.data_path == REMAPPED), None)


def curves(animation: bpy.types.AnimData) -> Iterator[bpy.types.FCurve]:
    """The curves of the active action."""
    return _curves_of(animation.action, animation.action_slot) if animation.action is not None else iter(())


def strip_curves(animation: bpy.types.AnimData) -> Iterator[bpy.types.FCurve]:
    """The curves of the actions in the NLA, if that is used."""
    strips = [strip for track in animation.nla_tracks for strip in track.strips] if animation.use_nla else []
    for strip in strips:  # which grows by what is in meta strips
        strips.extend(strip.strips)
        if strip.action is not None:
            yield from _curves_of(strip.action, strip.action_slot)


def _curves_of(action: bpy.types.Action, slot: bpy.types.ActionSlot) -> Iterator[bpy.types.FCurve]:
    """An action's curves that are not muted."""
    bags = [action] if hasattr(action, "fcurves") else []  # before Blender 5
    if not bags and slot is not None:
        bags = [strip.channelbag(slot) for layer in action.layers for strip in layer.strips]
    for bag in bags:
        for curve in bag.fcurves if bag is not None else ():
            if not curve.mute and not (curve.group is not None and curve.group.mute):
                yield curve
