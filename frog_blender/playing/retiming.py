"""Which of its frames a capture shows at a frame of the timeline: start, speed, repetition, or the curve of a user."""

from __future__ import annotations

import math
from typing import Any

REMAPPED = "frog.shown_frame"
"""The property whose curve is read directly: frame handlers run before Blender evaluates animation."""


def capture_frame(obj: Any, scene_frame: float, frame_count: int, evaluated: Any = None) -> float:
    """The capture's frame, counted from 0 (fractions are legal; outside of 0 and the last one it is held).

    Args:
        obj: what plays the capture; its ``frog`` settings decide.
        scene_frame: of the timeline, may be fractional.
        frame_count: of the capture.
        evaluated: the object as a depsgraph has it at that frame, where one was evaluated.
    """
    settings = obj.frog if evaluated is None else evaluated.frog
    if settings.use_remap:
        curve = _curve(obj) if evaluated is None else None
        return curve.evaluate(scene_frame) if curve is not None else settings.shown_frame
    return repeated((scene_frame - settings.start_frame) * settings.speed, settings.repeat, frame_count)


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


def is_known_late(obj: Any) -> bool:
    """Whether a driver or the NLA decides what is shown: nobody knows before Blender has evaluated the frame."""
    animation = obj.animation_data
    if animation is None or not obj.frog.use_remap:
        return False
    driven = any(driver.data_path == REMAPPED for driver in animation.drivers)
    return driven or (animation.use_nla and len(animation.nla_tracks) > 0)


def _curve(obj: Any) -> Any:
    """The curve that alone animates ``REMAPPED``, or None."""
    animation = obj.animation_data
    if animation is None or animation.action is None or is_known_late(obj):
        return None
    for curve in _curves(animation):
        if curve.data_path == REMAPPED:
            return curve
    return None


def _curves(animation: Any) -> Any:
    action = animation.action
    if hasattr(action, "fcurves"):  # before Blender 5
        return action.fcurves
    for layer in action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(animation.action_slot) if animation.action_slot is not None else None
            if bag is not None:
                return bag.fcurves
    return ()
