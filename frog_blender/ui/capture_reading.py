"""Reads the folders of captures beside Blender's main thread, since small videos are decoded for that."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path

import bpy

from .. import addon_state, redrawing
from ..engine.errors import FrogError, brief
from ..tasks.background_task import TIMER_SECONDS, BackgroundTask, begin_ticking, end_ticking
from . import capture_summary, report_images, torch_environment
from .capture_summary import CaptureSummary


class CaptureReading(BackgroundTask):
    """One folder: ``start()`` it, ``pump()`` it until ``is_running`` is false.

    Nothing stops one that has begun; what it finds may be left alone.

    Attributes:
        folder: an absolute path.
        stamp: of the folder, from before it was read.
        summary: what was found; None until then.
    """

    what = "reading of a capture"
    quit_seconds = 2.0

    def __init__(self, folder: str) -> None:
        super().__init__()
        self.folder, self.stamp = folder, capture_summary.stamp(folder)
        self.summary: CaptureSummary | None = None

    @property
    def is_running(self) -> bool:
        return self.summary is None

    def cancel(self) -> None:
        """Does nothing: no file is written."""

    def work(self) -> None:
        try:
            self.put(capture_summary.read(Path(self.folder)))
        except BaseException as error:  # ``read`` returns errors, but for memory and bugs
            traceback.print_exc(file=sys.stderr)
            reason = f"this capture cannot be read ({type(error).__name__}: {brief(error)})"
            self.put(CaptureSummary(error=f"{self.folder}: {reason}."))

    def apply(self, message: CaptureSummary) -> None:
        self.summary = message

    def death(self) -> CaptureSummary:
        return CaptureSummary(error=f"{self.folder}: reading this capture stopped without an error message.")


class Readings:
    """Those that run.

    Attributes:
        tasks: by folder; of one folder the last that was begun.
        chosen: a folder and its summary that was just read, while it becomes a scene's capture.
    """

    def __init__(self) -> None:
        self.tasks: dict[str, CaptureReading] = {}
        self.chosen: tuple[str, CaptureSummary] | None = None


def begin(folder: str) -> CaptureReading:
    """Starts reading a folder, for whoever pumps it; FrogError if no thread can be created."""
    torch_environment.add_environment()  # may have OpenCV, which reads videos
    return CaptureReading(folder).start()


def read(folder: str) -> CaptureSummary | None:
    """Reads a folder and shows what is in it.

    Returns:
        The summary, or None in a window, where it is read beside the main thread and shown when it is there.
    """
    readings = addon_state.get(Readings)
    chosen, readings.chosen = readings.chosen, None
    if chosen is not None and chosen[0] == folder:
        return _show(folder, chosen[1], capture_summary.stamp(folder))
    if bpy.app.background or not folder:
        torch_environment.add_environment()
        stamp = capture_summary.stamp(folder)
        return _show(folder, capture_summary.read(Path(folder)) if folder else CaptureSummary(), stamp)
    read_beside(folder)
    return None


def read_beside(folder: str) -> None:
    """Starts reading a folder, which a timer shows when it is read. One that is being read is read again."""
    try:
        addon_state.get(Readings).tasks[folder] = begin(folder)
    except FrogError as error:
        _show(folder, CaptureSummary(error=str(error)), capture_summary.stamp(folder))
        return
    begin_ticking(tick)


def is_reading(folder: str) -> bool:
    """Whether a folder is being read."""
    return folder in addon_state.get(Readings).tasks


def choose(scene: bpy.types.Scene, folder: str, summary: CaptureSummary) -> None:
    """Makes a folder that was just read the capture of a scene, without reading it again."""
    readings = addon_state.get(Readings)
    readings.chosen = (folder, summary)
    try:
        scene.frog.capture_folder = folder
    finally:
        readings.chosen = None


def tick() -> float | None:
    """What Blender's timer calls. Returns the seconds until the next call, None to end."""
    tasks = addon_state.get(Readings).tasks
    for folder, task in list(tasks.items()):
        task.pump()
        if task.summary is not None:
            del tasks[folder]
            _show(folder, task.summary, task.stamp)
    return TIMER_SECONDS if tasks else None


def _show(folder: str, summary: CaptureSummary, stamp: object) -> CaptureSummary:
    """Stores a summary and shows it where its folder is a scene's capture."""
    capture_summary.store(folder, summary, stamp)
    has_own = summary.clocks is not None and summary.clocks.is_own
    if folder:
        report_images.show(Path(folder), summary.capture if has_own else None)
    redrawing.viewports()  # where the rig is drawn, and the sidebars
    return summary


def register() -> None:
    """There is nothing to register."""


def unregister() -> None:
    end_ticking(tick)
    for task in addon_state.get(Readings).tasks.values():
        task.join()
