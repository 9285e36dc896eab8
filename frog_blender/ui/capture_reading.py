"""Reads the folders of captures beside Blender's main thread, since small videos are decoded for that."""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import addon_state, redrawing
from ..engine.errors import FrogError
from ..tasks.background_task import BackgroundTask, Ended
from . import capture_summary, report_images, torch_environment
from .capture_summary import CaptureSummary


class CaptureReading(BackgroundTask):
    """One folder; its result is the summary of it.

    Nothing stops one that has begun; what it finds may be left alone.

    Attributes:
        folder: an absolute path.
        stamp: of the folder, from before it was read.
    """

    what = "reading of the capture"
    quit_seconds = 2.0

    def __init__(self, folder: str) -> None:
        super().__init__()
        torch_environment.add_environment()  # may have OpenCV, which reads videos
        self.folder = self.slot = self.where = folder
        self.stamp = capture_summary.stamp(folder)

    def work(self) -> CaptureSummary:
        return capture_summary.read(Path(self.folder))

    def conclude(self, ended: Ended) -> None:
        """``read`` returns errors, but for memory and bugs."""
        self.result = ended.result or CaptureSummary(error=ended.error)


class _Chosen:
    """A folder and its summary that was just read, while it becomes a scene's capture."""

    summary: tuple[str, CaptureSummary] | None = None


def begin(folder: str) -> CaptureReading:
    """Starts reading a folder, for whoever pumps it; FrogError if no thread can be created."""
    return CaptureReading(folder).start()


def read(folder: str) -> CaptureSummary | None:
    """Reads a folder and shows what is in it.

    Returns:
        The summary, or None in a window, where it is read beside the main thread and shown when it is there.
    """
    state = addon_state.get(_Chosen)
    chosen, state.summary = state.summary, None
    if chosen is not None and chosen[0] == folder:
        return _show(folder, chosen[1], capture_summary.stamp(folder))
    if bpy.app.background or not folder:
        reading = CaptureReading(folder)
        return _show(folder, reading.work() if folder else CaptureSummary(), reading.stamp)
    read_beside(folder)
    return None


def read_beside(folder: str) -> None:
    """Starts reading a folder, which is shown when it is read. One that is being read is read again."""
    reading = CaptureReading(folder)
    reading.on_finished = lambda summary: _show(folder, summary, reading.stamp)
    try:
        reading.start().show()
    except FrogError as error:
        _show(folder, CaptureSummary(error=str(error)), reading.stamp)


def is_reading(folder: str) -> bool:
    """Whether a folder is being read."""
    reading = CaptureReading.current(folder)
    return reading is not None and reading.is_running


def choose(scene: bpy.types.Scene, folder: str, summary: CaptureSummary) -> None:
    """Makes a folder that was just read the capture of a scene, without reading it again."""
    state = addon_state.get(_Chosen)
    state.summary = (folder, summary)
    try:
        scene.frog.capture_folder = folder
    finally:
        state.summary = None


def _show(folder: str, summary: CaptureSummary, stamp: object) -> CaptureSummary:
    """Stores a summary and shows it where its folder is a scene's capture."""
    capture_summary.store(folder, summary, stamp)
    has_own = summary.clocks is not None and summary.clocks.is_own
    if folder:
        report_images.show(Path(folder), summary.capture if has_own else None)
    redrawing.viewports()  # where the rig is drawn, and the sidebars
    return summary
