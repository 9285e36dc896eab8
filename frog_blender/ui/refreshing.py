"""What a panel shows of files is looked at again when it is outdated: after drawing, which must not change anything."""

from __future__ import annotations

import time
from collections.abc import Callable

import bpy

from .. import addon_state
from ..timeline import playback

REST = 1.0  # seconds between two looks: what cannot be brought up to date must not keep Blender busy


class Refreshes:
    """What is to be looked at again.

    Attributes:
        wanted: what to call, by what it is for.
        looked_at: when that was done last (of ``time.monotonic``).
    """

    def __init__(self) -> None:
        self.wanted: dict[str, Callable[[], object]] = {}
        self.looked_at = -REST


def soon(key: str = "captures", look: Callable[[], object] = playback.refresh_all) -> None:
    """Calls ``look`` once when everything is drawn, however often it is asked for ``key``, and draws sidebars anew."""
    refreshes = addon_state.get(Refreshes)
    refreshes.wanted.setdefault(key, look)
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=max(0.0, refreshes.looked_at + REST - time.monotonic()))


def tick() -> None:
    """What Blender's timer calls: looks at everything that was asked for."""
    refreshes = addon_state.get(Refreshes)
    refreshes.looked_at = time.monotonic()
    looks = list(refreshes.wanted.values())
    refreshes.wanted.clear()
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
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
