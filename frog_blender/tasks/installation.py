"""The current installation, started by an operator and polled by a timer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

from .. import addon_state
from .installer import Installation
from .landmarks import LandmarkDownload
from .package_folders import CALIBRATION, TORCH, clear_remains, remains
from .packages import BYTES_NEEDED, CALIBRATION_BYTES_NEEDED, CALIBRATION_PACKAGES, CPU

TICK_SECONDS = 0.5
STOP_SECONDS = 10.0  # seconds for a cancelled installation to clean up when the add-on is disabled


class CurrentInstallation:
    """The running installation or the last one, and the callback for its folder."""

    def __init__(self) -> None:
        self.installation: Installation | LandmarkDownload | None = None
        self.on_done: Callable[[Path], None] = lambda folder: None


def folder(name: str = TORCH) -> Path:
    """Where this add-on's torch lies: with the user's extensions, so that it outlives upgrades of the add-on."""
    return Path(bpy.utils.user_resource("DATAFILES", path="frog_blender")) / name


def current() -> Installation | LandmarkDownload | None:
    """The running installation, or the last one."""
    return addon_state.get(CurrentInstallation).installation


def is_running() -> bool:
    """Whether an installation is running."""
    installation = current()
    return installation is not None and installation.running


def begin(arguments: Sequence[str], on_done: Callable[[Path], None], *, build: str = CPU) -> None:
    """Starts an installation of all packages with additional arguments for pip; FrogError if it cannot be started.

    Args:
        on_done: is given the folder when all is done, on Blender's main thread.
        build: of torch, which tells how much disk it needs.
    """
    _begin(Installation(folder(), arguments, bytes_needed=BYTES_NEEDED[build]), on_done)


def begin_calibration(arguments: Sequence[str], on_done: Callable[[Path], None]) -> None:
    """The same for what calibration needs, without torch."""
    packages = folder(CALIBRATION)
    _begin(
        Installation(packages, arguments, CALIBRATION_PACKAGES, bytes_needed=CALIBRATION_BYTES_NEEDED),
        on_done,
    )


def begin_landmarks() -> None:
    """Starts to fetch the file that finds a person's joints; FrogError if it cannot be started."""
    _begin(LandmarkDownload(), lambda folder: None)


def _begin(installation: Installation | LandmarkDownload, on_done: Callable[[Path], None]) -> None:
    state = addon_state.get(CurrentInstallation)
    state.installation, state.on_done = installation.start(), on_done
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK_SECONDS, persistent=True)


def cancel() -> None:
    """Cancels the running installation, if any, and discards what was downloaded."""
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
    for place in (folder(), folder(CALIBRATION)):
        if remains(place):  # removing gigabytes takes a while
            threading.Thread(target=clear_remains, args=(place,), name="FRoG tidying", daemon=True).start()


def unregister() -> None:
    installation = current()
    if installation is not None:
        installation.cancel()
        installation.join(STOP_SECONDS)
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
