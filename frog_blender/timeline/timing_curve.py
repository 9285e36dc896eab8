"""The curve of a capture's Shown Frame: made of its simpler settings, frozen, ramped, reversed and moved.

A user may edit the same curve in the Graph Editor: these functions keep the shape of what they do not change.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import bpy

from ..engine.errors import FrogError
from . import playback
from .retiming import REMAPPED, capture_frame, needs_evaluated_time, piece, shown_curve

_MOST_KEYS = 10_000
_APART = 0.011  # frames within which Blender has one key
_SOON = 0.05  # frames after which a loop that plays backward is at its end again
_STEP = 0.05  # frames, within which a speed is measured
_STEPS = 256  # at which a ramp is looked at
_SAME = 1e-3  # frames of the capture: nobody sees less


def problem(obj: bpy.types.Object) -> str:
    """Why a capture's time cannot be edited by its curve, or an empty string."""
    if needs_evaluated_time(obj):
        return "Its time is driven, in the NLA, or animated by other settings."
    curve = shown_curve(obj)
    if obj.frog.use_remap and curve is not None and curve.modifiers:
        return "The curve of its Shown Frame has modifiers."
    return ""


def check_editable(obj: bpy.types.Object) -> None:
    """FrogError for a capture whose time cannot be edited by its curve."""
    why = problem(obj)
    if why:
        raise FrogError(f"{obj.name}: found a time that cannot be edited, expected settings or a curve. {why}")


def ensure_curve(obj: bpy.types.Object, first: float, last: float) -> bpy.types.FCurve:
    """The curve of the Shown Frame; made of start, speed, repetition and trim, if these decide now.

    Args:
        first, last: frames of the timeline within which repetitions become keys.

    Raises:
        FrogError: for a time that cannot be edited, or too many repetitions.
    """
    check_editable(obj)
    if obj.frog.use_remap:
        curve = shown_curve(obj)
        if curve is not None and len(curve.keyframe_points):
            return curve
        return write_keys(obj, [(first, obj.frog.shown_frame, "LINEAR")])
    return write_keys(obj, _keys_of(obj, first, last))


def _keys_of(obj: bpy.types.Object, first: float, last: float) -> list[tuple[float, float, str]]:
    """Frame, value and interpolation of the keys that play as start, speed, repetition and trim do."""
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


def write_keys(obj: bpy.types.Object, keys: list[tuple[float, float, str]]) -> bpy.types.FCurve:
    """Makes keys (frame, value, interpolation) the whole curve of the Shown Frame, which decides from now on."""
    old = shown_curve(obj)
    if old is not None:
        _remove_after(old, -math.inf)
    for frame, _, _ in (keys[0], keys[-1]):  # which makes the curve, whatever holds curves in this Blender
        obj.keyframe_insert(REMAPPED, frame=frame)
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
    return curve


def freeze(curve: bpy.types.FCurve, frame: float, length: float) -> None:
    """Holds what is shown at a frame of the timeline for so many frames; what comes later comes that much later."""
    split(curve, frame)
    points, value = curve.keyframe_points, curve.evaluate(frame)
    begin = _key_at(curve, frame)
    if begin is None:  # before all keys, or after them
        begin = _insert(curve, frame, value)
    _free(begin)
    interpolation, right = begin.interpolation, tuple(begin.handle_right)
    begin.interpolation = "CONSTANT"
    for point in points:
        if point.co.x > frame + _APART:
            _shift(point, length)
    end = _insert(curve, frame + length, value, interpolation)
    _free(end)
    end.handle_left, end.handle_right = (frame + length - 1, value), (right[0] + length, right[1])
    curve.update()


def ramp(curve: bpy.types.FCurve, frame: float, length: float, speed: float, ends: tuple[float, float]) -> None:
    """Goes from the speed at a frame of the timeline to another one within so many frames, evenly, and on with it to
    the last frame that is played, or to the first one.

    Args:
        ends: these two frames of the capture.
    """
    value = curve.evaluate(frame)
    near = frame + (_STEP if _begins(curve, frame) else -_STEP)
    before = (curve.evaluate(near) - value) / (near - frame)
    split(curve, frame)
    _remove_after(curve, frame)
    # A cubic with handles at the thirds is even in time: its slope goes evenly from one speed to the other.
    third = length / 3
    begin = _key_at(curve, frame) or _insert(curve, frame, value)
    _free(begin)
    begin.handle_right, begin.interpolation = (frame + third, value + before * third), "BEZIER"
    reached = value + (before + speed) / 2 * length
    end = _insert(curve, frame + length, reached)
    _free(end)
    end.handle_left = frame + length - third, reached - speed * third
    curve.update()
    left = _left(curve, (frame, frame + length), (min(ends[0], value), max(ends[1], value)))
    goal = ends[1] if speed > 0 else ends[0]
    if left is not None:
        split(curve, left)
        _remove_after(curve, max(left, frame))
    elif speed and (goal - reached) / speed > 0:
        _insert(curve, frame + length + (goal - reached) / speed, goal)
    curve.update()


def _begins(curve: bpy.types.FCurve, frame: float) -> bool:
    """Whether a curve begins at a frame, or again, as a loop does: what was before says nothing of the speed there."""
    points = curve.keyframe_points
    if frame <= points[0].co.x + _APART:
        return True
    return any(
        before.interpolation == "CONSTANT" and frame - _STEP - _APART < after.co.x <= frame + _APART
        for before, after in pairwise(points)
    )


def _left(curve: bpy.types.FCurve, frames: tuple[float, float], ends: tuple[float, float]) -> float | None:
    """The frame between two of the timeline at which a curve leaves a range of values; None if it does not."""
    begin, length = frames[0], frames[1] - frames[0]

    def is_outside(share: float) -> bool:
        return not ends[0] - _SAME <= curve.evaluate(begin + share * length) <= ends[1] + _SAME

    outside = next((step for step in range(1, _STEPS + 1) if is_outside(step / _STEPS)), None)
    if outside is None:
        return None
    low, finer = (outside - 1) / _STEPS, 1 / (_STEPS << 30)
    return begin + length * (low + finer * bisect_left(range(1 << 30), True, key=lambda n: is_outside(low + finer * n)))


def _remove_after(curve: bpy.types.FCurve, frame: float) -> None:
    """Removes the keys after a frame."""
    for point in reversed(curve.keyframe_points):
        if point.co.x > frame + _APART:
            curve.keyframe_points.remove(point, fast=True)


def split(curve: bpy.types.FCurve, frame: float) -> None:
    """Adds a key at a frame between others, where the curve is; its shape stays, unless an easing made it."""
    points = curve.keyframe_points
    for before, after in pairwise(points):
        if before.co.x + _APART < frame < after.co.x - _APART:
            value, interpolation = curve.evaluate(frame), before.interpolation
            for point in (before, after):  # automatic ones would follow the new key
                _free(point)
            _free(_insert(curve, frame, value, interpolation))
            curve.update()
            return


@contextmanager
def new_keys(interpolation: str) -> Iterator[None]:
    """Inside, Blender gives new keys this interpolation, whatever the user prefers."""
    edit = bpy.context.preferences.edit
    preferred, edit.keyframe_new_interpolation_type = edit.keyframe_new_interpolation_type, interpolation
    try:
        yield
    finally:
        edit.keyframe_new_interpolation_type = preferred


def _insert(curve: bpy.types.FCurve, frame: float, value: float, interpolation: str = "LINEAR") -> bpy.types.Keyframe:
    """Adds a key. Between Bezier ones Blender divides the handles beside a Bezier one."""
    with new_keys(interpolation):
        added = curve.keyframe_points.insert(frame, value, options={"FAST"})
    added.interpolation = interpolation
    return added


def _key_at(curve: bpy.types.FCurve, frame: float) -> bpy.types.Keyframe | None:
    return next((point for point in curve.keyframe_points if abs(point.co.x - frame) < _APART), None)


def _free(point: bpy.types.Keyframe) -> None:
    """Lets a key's handles stay where they are, whatever its neighbours do."""
    left, right = tuple(point.handle_left), tuple(point.handle_right)
    point.handle_left_type = point.handle_right_type = "FREE"
    point.handle_left, point.handle_right = left, right


def reverse(curve: bpy.types.FCurve, first: float, last: float) -> None:
    """Shows what was shown first last, and the other way round: the curve upside down, fast and slow where it was.

    Args:
        first, last: frames of the timeline at which the capture is there: what it shows before and after does not
            count.
    """
    points = curve.keyframe_points
    begin, end = (min(max(edge, points[0].co.x), points[-1].co.x) for edge in (first, last))
    values = [curve.evaluate(begin), curve.evaluate(end)]
    values += [point.co.y for point in points if begin < point.co.x < end]
    total = min(values) + max(values)
    for point in points:
        handles = [(handle.x, total - handle.y) for handle in (point.handle_left, point.handle_right)]
        point.co.y = total - point.co.y
        point.handle_left, point.handle_right = handles
    curve.update()


def move(obj: bpy.types.Object, frames: float) -> None:
    """Moves all that a capture plays along the timeline; FrogError for a time that cannot be edited."""
    check_editable(obj)
    settings, curve = obj.frog, shown_curve(obj)
    settings.start_frame += frames
    settings.range_start += frames
    settings.range_end += frames
    if curve is not None:
        for point in curve.keyframe_points:
            _shift(point, frames)
        curve.update()


def _shift(point: bpy.types.Keyframe, frames: float) -> None:
    point.co_ui = point.co.x + frames, point.co.y  # and its handles
