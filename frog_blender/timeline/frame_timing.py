"""A capture's retiming frame by frame: as it is stored with edits, and as its sound follows it."""

import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing

import bpy

from ..engine.editing.edits import Timing
from ..engine.errors import FrogError
from . import playback, timing_curve
from .retiming import capture_frame, frame_rate, is_shown, needs_evaluated_time, stretched

_SAME = 1e-4  # of a frame: nobody sees it


def frames_shown(obj: bpy.types.Object, scene: bpy.types.Scene, numbers: Sequence[int]) -> list[float | None]:
    """The capture's frames, counted from 0 and held at its ends, that an object shows at frames of a scene's timeline;
    None where it is not there.

    If its time is driven or in the NLA, the scene is moved to each frame, and back.

    Raises:
        FrogError: for a file that cannot be played, or settings that lead to no frame.
    """
    count = playback.open_scene(playback.file_of(obj)).header.frame_count
    if not needs_evaluated_time(obj):
        return [_shown(obj, stretched(scene, frame), count) for frame in numbers]
    with closing(evaluated_frames(scene, numbers)) as depsgraphs:
        return [_shown(obj, scene.frame_current_final, count, obj.evaluated_get(depsgraph)) for depsgraph in depsgraphs]


def evaluated_frames(
    scene: bpy.types.Scene, numbers: Iterable[int], layer: bpy.types.ViewLayer | None = None
) -> Generator[bpy.types.Depsgraph, None, None]:
    """Moves a scene to frames of its timeline, and back when it is closed; gives what a view layer, by default the
    first one, has there.
    """
    stood, layer = (scene.frame_current, scene.frame_subframe), layer or scene.view_layers[0]
    try:
        for frame in numbers:
            scene.frame_set(frame)
            layer.update()
            yield layer.depsgraph
    finally:
        scene.frame_set(stood[0], subframe=stood[1])


def timing_of(obj: bpy.types.Object, scene: bpy.types.Scene) -> Timing:
    """How a capture plays in a scene's range of frames; see ``frames_shown``."""
    shown = frames_shown(obj, scene, range(scene.frame_start, scene.frame_end + 1))
    try:
        return Timing(tuple(shown), frame_rate(scene), scene.frame_start)
    except ValueError as error:
        raise FrogError(f"{scene.name}: found {error}, expected one that a file of edits can hold.") from error


def write_timing(obj: bpy.types.Object, timing: Timing, scene: bpy.types.Scene) -> None:
    """Makes a timing that of a capture: keys of its Shown Frame, as few as lie on straight lines, and its limits. It
    lasts as long, whatever the scene's rate.

    Raises:
        FrogError: for a time that is driven or in the NLA, which keys would not change.
    """
    timing_curve.check_editable(obj)
    length = frame_rate(scene) / timing.rate  # frames of the timeline

    def at(index: int) -> float:
        return stretched(scene, timing.start + index * length)

    there = [index for index, frame in enumerate(timing.frames) if frame is not None]
    if there:
        shown = [timing.capture_frame(index) for index in there]
        numbers = [at(index) for index in there]
        kept = _corners(numbers, shown)
        timing_curve.write_keys(obj, [(numbers[index], shown[index], "LINEAR") for index in kept])
    settings, is_cut = obj.frog, len(there) < len(timing.frames)
    settings.use_range = is_cut
    if is_cut:
        first, end = (there[0], there[-1] + 1) if there else (0, 0)
        settings.range_start, settings.range_end = at(first), at(end)


def _corners(numbers: list[float], shown: list[float]) -> list[int]:
    """Indices of the values without which straight lines would miss one of the others."""
    kept, begin = [0], 0
    low, high = -math.inf, math.inf  # slopes of lines from there that miss nothing
    for index in range(1, len(shown)):
        length, rise = numbers[index] - numbers[begin], shown[index] - shown[begin]
        if not low <= rise / length <= high:
            begin = index - 1
            kept.append(begin)
            length, rise = numbers[index] - numbers[begin], shown[index] - shown[begin]
            low, high = -math.inf, math.inf
        low, high = max(low, (rise - _SAME) / length), min(high, (rise + _SAME) / length)
    return [*kept, len(shown) - 1] if len(shown) > 1 else kept


def _shown(obj: bpy.types.Object, frame: float, count: int, evaluated: bpy.types.Object | None = None) -> float | None:
    if not is_shown(obj, frame):
        return None
    return min(max(capture_frame(obj, frame, count, evaluated), 0.0), count - 1.0)
