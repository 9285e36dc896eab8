"""Renders of images that FRoG's is laid over: whole, or stopped with a sentence.

Blender renders the scenes that a compositor shows after the scene that F12 was pressed in, by the first one's size and
region, and goes on whatever happens there. So what can be known is looked for before the first one starts, and stops
it; what comes later fills FRoG's image with a pattern that nobody takes for a result, and ends an animation.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ... import app_handlers
from ...engine.errors import FrogError
from ...timeline.render_thread import in_main_thread
from . import scenes
from .checks import foreign, trouble

_PAST_ALL = 1_048_574  # Blender's last frame: an animation that stands there has no further one


@dataclass
class _Render:
    """The render that goes on.

    Attributes:
        scene: that F12 was pressed in; None while nothing is rendered.
        splats: the scene of captures that is to be laid over it.
        refusal: why there is to be no image; empty if nothing is wrong.
        kept: settings of the scene, while others take their place in order to stop the render.
        drawn: whether FRoG has drawn the present frame.
        failure: why it could not.
        frame: where the scene stood before the animation was ended.
    """

    scene: Any = None
    splats: Any = None
    refusal: str = ""
    kept: dict[str, Any] = field(default_factory=dict)
    drawn: bool = False
    failure: str = ""
    frame: int | None = None


_render = _Render()
said: list[str] = []
"""What went wrong in the last render, for the panel."""


def leading(scene: Any) -> Any:
    """The scene whose image this one's is part of, by whose size, region and time Blender renders it: itself, if
    it is rendered alone."""
    try:
        if _render.scene is not None and _render.scene.name:
            return _render.scene
    except ReferenceError:
        pass  # that scene is gone, and nobody has said that its render is over
    return scene.frog.composed_with or scene


def check(scene: Any) -> None:
    """Raises FrogError if there is to be no image of a scene that FROG is about to draw."""
    first = leading(scene)
    if _render.refusal:
        raise FrogError(_render.refusal)
    if first != scene and scene.frog.composed_with not in (None, first):
        raise FrogError(foreign(first, scene))


def note_drawn(scene: Any, has_captures: bool) -> None:
    """To be told of an image that FROG has drawn."""
    if scene != _render.splats or _render.drawn:
        return
    _render.drawn = True
    if not has_captures and not said:
        _say(
            f"{leading(scene).name} shows no capture at frame {leading(scene).frame_current}: the image has the "
            "objects alone."
        )


def note_failure(scene: Any, sentence: str) -> bool:
    """To be told why FROG could not draw. Returns whether the image is part of another scene's, which goes on."""
    if leading(scene) == scene:
        return False
    _render.failure = sentence
    return True


def _say(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr)
    said.append(sentence)


@persistent
def _on_init(scene: Any, *_: Any) -> None:
    global _render
    _restore()
    said.clear()
    _render = _Render(scene)
    if in_main_thread():
        scenes.follow_all()
    _render.refusal = trouble(scene)
    _render.splats = scenes.laid_over(scene)
    if _render.refusal and in_main_thread() and scene.render.engine != "FROG":
        _stop(scene.render)


def _stop(render: Any) -> None:
    """The one way to stop a render before it begins: the engine that is asked for the image refuses. Compositor and
    sequencer might not ask it."""
    instead = {"engine": "FROG", "use_compositing": False, "use_sequencer": False}
    _render.kept = {name: getattr(render, name) for name in instead}
    for name, value in instead.items():
        setattr(render, name, value)


@persistent
def _on_pre(scene: Any, *_: Any) -> None:
    if scene == _render.scene:
        _render.drawn, _render.failure = False, ""
        if in_main_thread() and not _render.kept:
            scenes.follow_all(objects_changed=False)  # settings may be animated


@persistent
def _on_post(scene: Any, *_: Any) -> None:
    """Of what went wrong in this frame."""
    if scene != _render.scene or _render.kept:
        return
    failure = _render.failure
    if not failure and _render.splats is not None and not _render.drawn:
        failure = f"{_render.splats.name} was not rendered: the image lacks the captures."
    if failure and failure not in said:
        _say(failure)
    _render.failure = failure


@persistent
def _on_write(scene: Any, *_: Any) -> None:
    """Ends an animation whose image has failed."""
    if scene == _render.scene and _render.failure and _render.frame is None:
        _render.frame, scene.frame_current = scene.frame_current, _PAST_ALL


@persistent
def _on_end(scene: Any, *_: Any) -> None:
    global _render
    if scene == _render.scene:
        _restore()
        _render = _Render()


def _restore() -> None:
    """Gives the scene back what stopping the render has changed."""
    try:
        for name, value in _render.kept.items():
            setattr(_render.scene.render, name, value)
        if _render.frame is not None and _render.scene.frame_current == _PAST_ALL:
            _render.scene.frame_current = _render.frame
    except ReferenceError:
        pass  # the scene is gone
    _render.kept, _render.frame = {}, None


@persistent
def _on_save_pre(*_: Any) -> None:
    if not bpy.app.is_job_running("RENDER"):
        _restore()


@persistent
def _on_load_pre(*_: Any) -> None:
    global _render
    _render = _Render()
    said.clear()


def _handlers() -> app_handlers.Handlers:
    on = bpy.app.handlers
    return [
        (on.render_init, _on_init),
        (on.render_pre, _on_pre),
        (on.render_post, _on_post),
        (on.render_write, _on_write),
        (on.render_complete, _on_end),
        (on.render_cancel, _on_end),
        (on.save_pre, _on_save_pre),
        (on.load_pre, _on_load_pre),
    ]


def register() -> None:
    app_handlers.add(_handlers())


def unregister() -> None:
    app_handlers.remove(_handlers())
    _restore()
