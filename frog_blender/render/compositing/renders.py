"""Renders of composed images: complete, or stopped with a message.

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

from ... import addon_state, app_handlers
from ...engine.errors import FrogError
from ...timeline.render_thread import in_main_thread
from ...timeline.retiming import LAST_FRAME
from .. import exit_status
from . import scenes
from .checks import foreign, trouble


@dataclass
class _Render:
    """The current render.

    Attributes:
        scene: that F12 was pressed in; None while nothing is rendered.
        splats: the scene of captures that is to be laid over it.
        refusal: why there is to be no image; empty if nothing is wrong.
        kept: settings of the scene, while others take their place in order to stop the render.
        drawn: whether FRoG has drawn the present frame.
        failure: why it could not.
        frame: where the scene stood before the animation was ended.
    """

    scene: Any = None  # Any: a Scene that may be gone, which each access of it tells
    splats: bpy.types.Scene | None = None
    refusal: str = ""
    kept: dict[str, Any] = field(default_factory=dict)
    drawn: bool = False
    failure: str = ""
    frame: int | None = None


class ComposedRenders:
    """The current render, and the problems of the last one, a sentence each."""

    def __init__(self) -> None:
        self.current = _Render()
        self.problems: list[str] = []


def _renders() -> ComposedRenders:
    return addon_state.get(ComposedRenders)


def problems() -> list[str]:
    """Problems of the last render, for the panel."""
    return _renders().problems


def leading(scene: bpy.types.Scene) -> bpy.types.Scene:
    """The scene whose render this scene is part of. Blender uses its size, region and time. The scene itself if it
    is rendered alone.
    """
    first = _renders().current.scene
    try:
        if first is not None and first.name:
            return first
    except ReferenceError:
        pass  # that scene is gone, and the end of its render was not reported
    return scene.frog.composed_with or scene


def check(scene: bpy.types.Scene) -> None:
    """Raises FrogError if a scene that FROG is about to draw must not be rendered."""
    first = leading(scene)
    refusal = _renders().current.refusal
    if refusal:
        raise FrogError(refusal)
    if first != scene and scene.frog.composed_with not in (None, first):
        raise FrogError(foreign(first, scene))


def note_drawn(scene: bpy.types.Scene, has_captures: bool) -> None:
    """Notes that FROG has drawn an image."""
    render = _renders().current
    if scene != render.splats or render.drawn:
        return
    render.drawn = True
    if not has_captures and not problems():
        _report(
            f"{leading(scene).name} shows no capture at frame {leading(scene).frame_current}. The image has the "
            "objects only."
        )


def note_failure(scene: bpy.types.Scene, sentence: str) -> bool:
    """Notes why FROG could not draw. Returns whether the image is part of another scene's render."""
    if leading(scene) == scene:
        return False
    _renders().current.failure = sentence
    return True


def _report(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr)
    problems().append(sentence)


@persistent
def _on_init(scene: bpy.types.Scene, *_: Any) -> None:
    _restore()
    problems().clear()
    render = _renders().current = _Render(scene)
    if in_main_thread():
        scenes.follow_all()
    render.refusal = trouble(scene)
    render.splats = scenes.overlay_of(scene)
    if render.refusal and in_main_thread() and scene.render.engine != "FROG":
        _stop(render)


def _stop(render: _Render) -> None:
    """Stops a render before it begins. The only way is to let an engine refuse; compositor and sequencer are
    disabled because they might not call it.
    """
    instead = {"engine": "FROG", "use_compositing": False, "use_sequencer": False}
    settings = render.scene.render
    render.kept = {name: getattr(settings, name) for name in instead}
    for name, value in instead.items():
        setattr(settings, name, value)


@persistent
def _on_pre(scene: bpy.types.Scene, *_: Any) -> None:
    render = _renders().current
    if scene == render.scene:
        render.drawn, render.failure = False, ""
        if in_main_thread() and not render.kept:
            scenes.follow_all(objects_changed=False)  # settings may be animated


@persistent
def _on_post(scene: bpy.types.Scene, *_: Any) -> None:
    """Collects the problems of this frame."""
    render = _renders().current
    if scene != render.scene or render.kept:
        return
    failure = render.failure
    if not failure and render.splats is not None and not render.drawn:
        failure = f"{render.splats.name} was not rendered. The captures are missing from the image."
    if failure:
        exit_status.note_failure()
    if failure and failure not in problems():
        _report(failure)
    render.failure = failure


@persistent
def _on_write(scene: bpy.types.Scene, *_: Any) -> None:
    """Ends an animation whose image has failed."""
    render = _renders().current
    if scene == render.scene and render.failure and render.frame is None:
        render.frame, scene.frame_current = scene.frame_current, LAST_FRAME


@persistent
def _on_end(scene: bpy.types.Scene, *_: Any) -> None:
    if scene == _renders().current.scene:
        _restore()
        _renders().current = _Render()


def _restore() -> None:
    """Restores the settings that were changed to stop the render."""
    render = _renders().current
    try:
        for name, value in render.kept.items():
            setattr(render.scene.render, name, value)
        if render.frame is not None and render.scene.frame_current == LAST_FRAME:
            render.scene.frame_current = render.frame
    except ReferenceError:
        pass  # the scene is gone
    render.kept, render.frame = {}, None


@persistent
def _on_save_pre(*_: Any) -> None:
    if not bpy.app.is_job_running("RENDER"):
        _restore()


@persistent
def _on_load_pre(*_: Any) -> None:
    _renders().current = _Render()
    problems().clear()


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
