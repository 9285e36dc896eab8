"""What may be changed during a render, which steps through frames in its own thread while windows draw."""

import threading

import bpy

from .. import addon_state


class Rendering:
    """What is known of renders.

    Attributes:
        is_under_way: of any engine.
        has_render_density: whether captures show what they are to show in another engine's render.
    """

    def __init__(self) -> None:
        self.is_under_way = self.has_render_density = False


def rendering() -> Rendering:
    """What is known now."""
    return addon_state.get(Rendering)


def in_main_thread() -> bool:
    """Whether this is Blender's main thread, the only one that may access all of ``bpy.data``.

    Blender renders in a thread of its own, but for scripts and without a window.
    """
    return threading.current_thread() is threading.main_thread()


def may_write_points(scene: bpy.types.Scene) -> bool:
    """Whether captures' points may be written after a change of frame. The FROG engine does not need them."""
    if in_main_thread() and not bpy.app.background:
        return True
    if rendering().is_under_way and scene.render.engine == "FROG":
        return False
    return is_never_drawn_meanwhile(scene)


def is_never_drawn_meanwhile(scene: bpy.types.Scene) -> bool:
    """Whether no window can draw points while a render's thread writes them, which would crash Blender."""
    return bpy.app.background or scene.render.use_lock_interface
