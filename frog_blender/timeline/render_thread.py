"""What a render that is under way allows: it goes through the frames in a thread of its own while windows draw."""

from __future__ import annotations

import threading
from typing import Any

import bpy

from .. import addon_state


class RenderState:
    """Whether a render is under way."""

    def __init__(self) -> None:
        self.is_rendering = False


def is_rendering() -> bool:
    """Whether a render is under way, of any engine."""
    return addon_state.get(RenderState).is_rendering


def set_rendering(value: bool) -> None:
    """To be told when a render begins and ends."""
    addon_state.get(RenderState).is_rendering = value


def in_main_thread() -> bool:
    """Whether Blender's own thread runs this, which alone may look at all of ``bpy.data``.

    Blender renders in a thread of its own, but for scripts and without a window.
    """
    return threading.current_thread() is threading.main_thread()


def may_write_points(scene: Any) -> bool:
    """Whether captures' points may be written now that a scene is at another frame. The FROG engine needs none."""
    if in_main_thread() and not bpy.app.background:
        return True
    if is_rendering() and scene.render.engine == "FROG":
        return False
    return is_never_drawn_meanwhile(scene)


def is_never_drawn_meanwhile(scene: Any) -> bool:
    """A window that is not locked may draw the points while a render's thread writes them, which Blender does not
    survive."""
    return bpy.app.background or scene.render.use_lock_interface
