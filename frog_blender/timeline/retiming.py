"""Which of its frames a capture shows at a frame of the timeline: start, speed, repetition, or the curve of a user."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from ..engine.errors import FrogError

REMAPPED = "frog.shown_frame"
"""The property whose curve is read directly: frame handlers run before Blender evaluates animation."""
TIMING = ("frog.start_frame", "frog.speed", "frog.repeat", "frog.use_remap", REMAPPED)
"""All properties that decide what is shown."""


class BadTiming(FrogError):
    """What decides the frame to show is no number; a file, a driver or a curve can make it so."""


def capture_frame(obj: Any, scene_frame: float, frame_count: int, evaluated: Any = None) -> float:
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


def problem(obj: Any, scene_frame: float) -> str:
    """Why a capture shows no frame at one of the timeline, or an empty string."""
    try:
        capture_frame(obj, scene_frame, 1)
    except BadTiming as error:
        return str(error)
    return ""


def _finite(frame: float, obj: Any, name: str) -> float:
    if not math.isfinite(frame):
        raise BadTiming(f"{obj.name}: {name} is not a number; the capture stays at its current frame.")
    return frame


def repeated(position: float, repeat: str, frame_count: int) -> float:
    """A position on the capture's own time axis, in frames, brought back into it.

    "HOLD" leaves it as it is, "LOOP" begins again one frame after the last, "PING_PONG" turns around at the ends.
    """
    last = frame_count - 1
    if repeat == "HOLD" or last < 1:
        return position
    if repeat == "LOOP":
        return math.fmod(math.fmod(position, frame_count) + frame_count, frame_count)
    turn = math.fmod(math.fmod(position, 2 * last) + 2 * last, 2 * last)
    return turn if turn <= last else 2 * last - turn


def raw_frame(scene: Any) -> float:
    """The frame of the timeline where a scene stands, as ``frame_set`` takes it."""
    return scene.frame_current + scene.frame_subframe


def stretched(scene: Any, frame: float) -> float:
    """What Blender's Time Stretching makes of a frame: ``frame_current_final`` where a scene stands there."""
    return frame * scene.render.frame_map_old / scene.render.frame_map_new


def needs_evaluated_time(obj: Any) -> bool:
    """Whether drivers, the NLA or curves of other settings decide what is shown: nobody knows before Blender has
    evaluated the frame."""
    animation = obj.animation_data
    if animation is None:
        return False
    if any(driver.data_path in TIMING for driver in animation.drivers):
        return True
    if any(curve.data_path in TIMING and curve.data_path != REMAPPED for curve in curves(animation)):
        return True
    strips = [strip for track in animation.nla_tracks for strip in track.strips] if animation.use_nla else []
    return any(
        curve.data_path in TIMING
        for strip in strips
        if strip.action is not None
        for curve in _curves_of(strip.action, strip.action_slot)
    )


def _curve(obj: Any) -> Any:
    """The curve that alone animates ``REMAPPED``, or None."""
    animation = obj.animation_data
    if animation is None or needs_evaluated_time(obj):
        return None
    return next((curve for curve in curves(animation) if curve.data_path == REMAPPED), None)


def curves(animation: Any) -> Iterator[Any]:
    """Those of the action that is not in the NLA."""
    return _curves_of(animation.action, animation.action_slot) if animation.action is not None else iter(())


def _curves_of(action: Any, slot: Any) -> Iterator[Any]:
    """An action's curves that Blender obeys."""
    bags = [action] if hasattr(action, "fcurves") else []  # before Blender 5
    if not bags and slot is not None:
        bags = [strip.channelbag(slot) for layer in action.layers for strip in layer.strips]
    for bag in bags:
        for curve in bag.fcurves if bag is not None else ():
            if not curve.mute and not (curve.group is not None and curve.group.mute):
                yield curve
