"""The installation of torch that Blender shows: begun by a button, looked after by a timer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

from .. import addon_state
from .folders import clear_remains, remains
from .installer import Installation

TICK_SECONDS = 0.5
STOP_SECONDS = 10.0  # what a cancelled installation gets to clear up when the add-on is switched off


class CurrentInstallation:
    """The installation that runs, or the last that ran, and who is told of the folder that it has filled."""

    def __init__(self) -> None:
        self.installation: Installation | None = None
        self.on_done: Callable[[Path], None] = lambda folder: None


def folder() -> Path:
    """Where this add-on's torch lies: with the user's extensions, so that it outlives upgrades of the add-on."""
    return Path(bpy.utils.user_resource("DATAFILES", path="frog_blender")) / "torch"


def current() -> Installation | None:
    """The installation that runs, or the last that ran."""
    return addon_state.get(CurrentInstallation).installation


def is_running() -> bool:
    """Whether pip is at work."""
    installation = current()
    return installation is not None and installation.running


def begin(arguments: Sequence[str], on_done: Callable[[Path], None]) -> None:
    """Starts pip with these further arguments; FrogError where it cannot be.

    Args:
        on_done: is given the folder when all is done, on Blender's main thread.
    """
    state = addon_state.get(CurrentInstallation)
    state.installation, state.on_done = Installation(folder(), arguments).start(), on_done
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK_SECONDS, persistent=True)


def cancel() -> None:
    """Ends the installation, if one runs; what was fetched so far is thrown away."""
    installation = current()
    if installation is not None:
        installation.cancel()


def tick() -> float | None:
    """What Blender's timer calls. Returns the seconds until the next call, None to end."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("PREFERENCES", "VIEW_3D"):
                area.tag_redraw()
    if is_running():
        return TICK_SECONDS
    state = addon_state.get(CurrentInstallation)
    if state.installation is not None and state.installation.done:
        state.on_done(state.installation.folder)
    return None


def register() -> None:
    place = folder()
    if remains(place):  # gigabytes, which take a while
        threading.Thread(target=clear_remains, args=(place,), name="FRoG tidying", daemon=True).start()


def unregister() -> None:
    installation = current()
    if installation is not None:
        installation.cancel()
        installation.join(STOP_SECONDS)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
