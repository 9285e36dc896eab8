"""What a render that is under way allows: it goes through the frames in a thread of its own while windows draw."""

from __future__ import annotations

import threading
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .. import app_handlers
from . import level_of_detail

_is_rendering = False


def in_main_thread() -> bool:
    """Whether Blender's own thread runs this, which alone may look at all of ``bpy.data``.

    Blender renders in a thread of its own, but for scripts and without a window.
    """
    return threading.current_thread() is threading.main_thread()


def may_write_points(scene: Any) -> bool:
    """Whether captures' points may be written now that a scene is at another frame. The FROG engine needs none."""
    if in_main_thread() and not bpy.app.background:
        return True
    if _is_rendering and scene.render.engine == "FROG":
        return False
    return _is_never_drawn_meanwhile(scene)


def _is_never_drawn_meanwhile(scene: Any) -> bool:
    """A window that is not locked may draw the points while a render's thread writes them, which Blender does not
    survive."""
    return bpy.app.background or scene.render.use_lock_interface


@persistent
def _on_init(scene: Any, *_: Any) -> None:
    global _is_rendering
    _is_rendering = True
    level_of_detail.show_for_render(_is_never_drawn_meanwhile(scene) and scene.render.engine != "FROG")


@persistent
def _on_end(*_: Any) -> None:
    """Without windows the points now show the frame that they were not written for."""
    global _is_rendering
    from . import playback

    _is_rendering = False
    level_of_detail.show_for_render(False)
    if bpy.app.background and in_main_thread():
        playback.refresh_all()


def _handlers() -> app_handlers.Handlers:
    on = bpy.app.handlers
    return [(on.render_init, _on_init), (on.render_complete, _on_end), (on.render_cancel, _on_end)]


def register() -> None:
    app_handlers.add(_handlers())


def unregister() -> None:
    global _is_rendering
    app_handlers.remove(_handlers())
    _is_rendering = False
    level_of_detail.forget()
