"""Which frames come next while one plays or scrubs; the playback cache's thread computes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import bpy

from .. import addon_state
from ..engine.errors import FrogError
from . import playback, playback_cache
from .playback_cache import SceneTime
from .retiming import raw_frame, stretched

AHEAD = 24  # frames
AHEAD_WHILE_TRAINING = 2
"""While a training wants the same cores: the next frame, and one more so that a slow one does not hold up playing.
Every frame beyond them is work that scrubbing throws away."""
_FARTHEST_STEP = 8.0  # frames of the timeline; who goes farther at once has jumped, not played


class Playing:
    """How scenes are played.

    Attributes:
        before: a scene's frame and step, by session_uid: which way it is being played.
        is_training: whether a training wants the same cores; see ``share_cores``.
    """

    def __init__(self) -> None:
        self.before: dict[int, tuple[float, float]] = {}
        self.is_training: Callable[[], bool] = lambda: False


def share_cores(is_training: Callable[[], bool]) -> None:
    """Leaves most of the cores to a training for as long as this says that one is running."""
    addon_state.get(Playing).is_training = is_training


def step_to(scene: Any, frame: float) -> float:
    """Frames from one shown frame to the next, as observed: below zero while one plays backwards."""
    before = addon_state.get(Playing).before
    last, step = before.get(scene.session_uid, (frame, 1.0))
    if frame != last:
        observed, first, final = frame - last, *_range(scene)
        goes_round = (last, frame) in ((final, first), (first, final))
        if not goes_round or first == final:
            step = observed if abs(observed) <= _FARTHEST_STEP else 1.0
    before[scene.session_uid] = frame, step
    return step


def frames_after(scene: Any, frame: float, step: float) -> Iterator[float]:
    """The frames that follow, without end; within the scene's range playing begins again at its other end."""
    first, last = _range(scene)
    while True:
        inside = first <= frame <= last
        frame += step
        if inside and not first <= frame <= last:
            frame = float(first if step > 0 else last)
        yield frame


def times_after(scene: Any, frame: float, step: float) -> list[SceneTime]:
    """What the scene's captures show next, as much as half of the cache holds."""
    found: dict[Any, SceneTime] = {}
    room = playback_cache.frames().limit // 2
    objects = playback.captures_in(scene)
    for following in islice(frames_after(scene, frame, step), _frames_ahead()):
        for each in _shown(scene, objects, stretched(scene, following)):
            if each.key in found or not each.scene.changing:
                continue
            room -= each.scene.delta_bytes
            if room < 0:
                return list(found.values())
            found[each.key] = each
    return list(found.values())


def _frames_ahead() -> int:
    return AHEAD_WHILE_TRAINING if addon_state.get(Playing).is_training() else AHEAD


def _shown(scene: Any, objects: list[Any], frame: float) -> Iterator[SceneTime]:
    """What the objects' points show at a frame, and what FRoG draws of them, which may be more."""
    for obj in objects:
        try:
            yield playback.displayed(obj, frame)
            if scene.render.engine == "FROG":
                yield playback.scene_time(obj, frame)
        except FrogError:
            continue  # said already when the present frame was shown


def prefetch(scene: Any) -> None:
    """Has the thread compute what comes after the scene's present frame."""
    frame = raw_frame(scene)
    playback_cache.worker().ask(times_after(scene, frame, step_to(scene, frame)))


def _range(scene: Any) -> tuple[int, int]:
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    return scene.frame_start, scene.frame_end


def is_watched() -> bool:
    """Somebody looks at the timeline; a render, which waits for each frame, needs all cores for the present one."""
    return not (bpy.app.background or bpy.app.is_job_running("RENDER"))


def forget() -> None:
    """Forgets which way scenes were played, as for another file."""
    addon_state.get(Playing).before.clear()
