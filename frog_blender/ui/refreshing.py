"""What a panel shows of files is looked at again when it is outdated: after drawing, which must not change anything."""

from __future__ import annotations

import time
from collections.abc import Callable

import bpy

from ..timeline import playback

_REST = 1.0  # seconds between two looks: what cannot be brought up to date must not keep Blender busy
_looked_at = -_REST
_wanted: dict[str, Callable[[], object]] = {}


def soon(key: str = "captures", look: Callable[[], object] = playback.refresh_all) -> None:
    """Calls ``look`` once when everything is drawn, however often it is asked for ``key``, and draws sidebars anew."""
    _wanted.setdefault(key, look)
    if not bpy.app.timers.is_registered(_look):
        bpy.app.timers.register(_look, first_interval=max(0.0, _looked_at + _REST - time.monotonic()))


def _look() -> None:
    global _looked_at
    _looked_at = time.monotonic()
    looks = list(_wanted.values())
    _wanted.clear()
    for look in looks:
        look()
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if region.type == "UI":
                    region.tag_redraw()


def register() -> None:
    """Nothing waits before something was drawn."""


def unregister() -> None:
    _wanted.clear()
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)
