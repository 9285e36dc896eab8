"""Predicts the next frames during playback and scrubbing; the playback cache's thread computes them."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice

import bpy

from .. import addon_state
from ..engine.errors import FrogError
from ..engine.playback.frame_delta import Key
from . import playback, playback_cache
from .playback_cache import SceneTime
from .retiming import raw_frame, stretched

AHEAD = 24  # frames
AHEAD_WHILE_TRAINING = 2
"""While a training uses the same cores: the next frame, and one more so that a slow one does not delay playback.
Further frames would be wasted when scrubbing.
"""
_FARTHEST_STEP = 8.0  # frames of the timeline; a larger step is a jump, not playback


class Playing:
    """Playback direction and load.

    Attributes:
        before: a scene's frame and step, by session_uid: which way it is being played.
        is_training: whether a training wants the same cores; see ``share_cores``.
    """

    def __init__(self) -> None:
        self.before: dict[int, tuple[float, float]] = {}
        self.is_training: Callable[[], bool] = lambda: False


def share_cores(is_training: Callable[[], bool]) -> None:
    """Prefetches less while ``is_training()`` is true."""
    addon_state.get(Playing).is_training = is_training


def step_to(scene: bpy.types.Scene, frame: float) -> float:
    """Observed step from one shown frame to the next, negative during reverse playback."""
    before = addon_state.get(Playing).before
    last, step = before.get(scene.session_uid, (frame, 1.0))
    if frame != last:
        observed, first, final = frame - last, *_range(scene)
        goes_round = (last, frame) in ((final, first), (first, final))
        if not goes_round or first == final:
            step = observed if abs(observed) <= _FARTHEST_STEP else 1.0
    before[scene.session_uid] = frame, step
    return step


def frames_after(scene: bpy.types.Scene, frame: float, step: float) -> Iterator[float]:
    """The following frames, endlessly; playback wraps around at the ends of the scene's frame range."""
    first, last = _range(scene)
    while True:
        inside = first <= frame <= last
        frame += step
        if inside and not first <= frame <= last:
            frame = float(first if step > 0 else last)
        yield frame


def times_ahead(scene: bpy.types.Scene) -> list[SceneTime]:
    """What the scene's captures show after its current frame, up to half the size of the cache."""
    times: dict[Key, SceneTime] = {}
    frame = raw_frame(scene)
    step = step_to(scene, frame)
    room = playback_cache.frames().limit // 2
    playing = list(_opened(scene))
    ahead = AHEAD_WHILE_TRAINING if addon_state.get(Playing).is_training() else AHEAD
    for following in islice(frames_after(scene, frame, step), ahead):
        for scene_time in _shown(scene, playing, stretched(scene, following)):
            if scene_time.source_key in times or not scene_time.scene.source.changing:
                continue
            room -= scene_time.scene.source.delta_bytes
            if room < 0:
                return list(times.values())
            times[scene_time.source_key] = scene_time
    return list(times.values())


def _opened(scene: bpy.types.Scene) -> Iterator[playback.Opened]:
    """What the scene's captures play: files are looked at once, not for each of the frames ahead."""
    for obj in playback.captures_in(scene):
        with suppress(FrogError):  # already reported when the current frame was shown
            yield playback.opened(obj)


def _shown(scene: bpy.types.Scene, playing: list[playback.Opened], frame: float) -> Iterator[SceneTime]:
    """What the objects' points show at a frame, and what the FROG engine draws, which may be more."""
    for capture in playing:
        with suppress(FrogError):
            yield capture.displayed(frame)
            if scene.render.engine == "FROG" and capture.fewer is not None:
                yield capture.whole(frame)


def prefetch(scene: bpy.types.Scene) -> None:
    """Requests the frames that follow the scene's current frame."""
    playback_cache.compute_ahead(times_ahead(scene))


def _range(scene: bpy.types.Scene) -> tuple[int, int]:
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    return scene.frame_start, scene.frame_end


def forget() -> None:
    """Forgets the playback direction of all scenes."""
    addon_state.get(Playing).before.clear()
