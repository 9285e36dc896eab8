"""Which frames come next while one plays or scrubs; the playback cache's thread computes them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .. import app_handlers
from ..engine.errors import FrogError
from ..training_task import runner
from . import playback, playback_cache
from .playback_cache import Moment
from .retiming import raw_frame, stretched

AHEAD = 24  # frames
AHEAD_WHILE_TRAINING = 2
"""While a training wants the same cores: the next frame, and one more so that a slow one does not hold up playing.
Every frame beyond them is work that scrubbing throws away."""
_FARTHEST_STEP = 8.0  # frames of the timeline; who goes farther at once has jumped, not played
_before: dict[int, tuple[float, float]] = {}  # a scene's frame and step, by session_uid: which way it is being played


def step_to(scene: Any, frame: float) -> float:
    """Frames from one shown frame to the next, as observed: below zero while one plays backwards."""
    last, step = _before.get(scene.session_uid, (frame, 1.0))
    if frame != last:
        observed, first, final = frame - last, *_range(scene)
        goes_round = (last, frame) in ((final, first), (first, final))
        if not goes_round or first == final:
            step = observed if abs(observed) <= _FARTHEST_STEP else 1.0
    _before[scene.session_uid] = frame, step
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


def moments_after(scene: Any, frame: float, step: float) -> list[Moment]:
    """What the scene's captures show next, as much as half of the cache holds."""
    found: dict[Any, Moment] = {}
    room = playback_cache.frames.limit // 2
    objects = playback.captures_in(scene)
    for following in islice(frames_after(scene, frame, step), _frames_ahead()):
        for moment in _shown(scene, objects, stretched(scene, following)):
            if moment.key in found or not moment.scene.changing:
                continue
            room -= moment.scene.delta_bytes
            if room < 0:
                return list(found.values())
            found[moment.key] = moment
    return list(found.values())


def _frames_ahead() -> int:
    trains = runner.is_running() and not runner.is_paused()
    return AHEAD_WHILE_TRAINING if trains else AHEAD


def _shown(scene: Any, objects: list[Any], frame: float) -> Iterator[Moment]:
    """What the objects' points show at a frame, and what FRoG draws of them, which may be more."""
    for obj in objects:
        try:
            yield playback.displayed(obj, frame)
            if scene.render.engine == "FROG":
                yield playback.moment(obj, frame)
        except FrogError:
            continue  # said already when the present frame was shown


def look_ahead(scene: Any) -> None:
    """Has the thread compute what comes after the scene's present frame."""
    frame = raw_frame(scene)
    playback_cache.worker.ask(moments_after(scene, frame, step_to(scene, frame)))


def _range(scene: Any) -> tuple[int, int]:
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    return scene.frame_start, scene.frame_end


def _is_watched() -> bool:
    """Somebody looks at the timeline; a render, which waits for each frame, needs all cores for the present one."""
    return not (bpy.app.background or bpy.app.is_job_running("RENDER"))


@persistent
def _on_frame(scene: Any, *_: Any) -> None:
    if _is_watched():
        look_ahead(scene)


@persistent
def _on_load(*_: Any) -> None:
    _before.clear()


def register() -> None:
    app_handlers.add(_handlers())


def unregister() -> None:
    app_handlers.remove(_handlers())
    _before.clear()


def _handlers() -> app_handlers.Handlers:
    return [(bpy.app.handlers.frame_change_post, _on_frame), (bpy.app.handlers.load_post, _on_load)]
