"""Reads files again that a panel found outdated: after drawing, which must not change anything."""

import time
from collections.abc import Callable

from .. import addon_state, app_handlers, redrawing
from ..timeline import playback

REST = 1.0  # seconds between refreshes: what stays outdated must not keep Blender busy


class Refreshes:
    """Pending refreshes.

    Attributes:
        pending: what to call, by what it is for.
        refreshed_at: when that was done last (of ``time.monotonic``).
    """

    def __init__(self) -> None:
        self.pending: dict[str, Callable[[], object]] = {}
        self.refreshed_at = -REST


def soon(key: str = "captures", refresh: Callable[[], object] = playback.refresh_all) -> None:
    """Calls ``refresh`` once after drawing, however often it is requested for ``key``, and redraws sidebars."""
    refreshes = addon_state.get(Refreshes)
    refreshes.pending.setdefault(key, refresh)
    app_handlers.later(tick, max(0.0, refreshes.refreshed_at + REST - time.monotonic()))


def tick() -> None:
    """Called by Blender's timer: runs all pending refreshes."""
    refreshes = addon_state.get(Refreshes)
    refreshes.refreshed_at = time.monotonic()
    pending, refreshes.pending = refreshes.pending, {}
    for refresh in pending.values():
        refresh()
    redrawing.sidebars()


def unregister() -> None:
    app_handlers.not_later(tick)
