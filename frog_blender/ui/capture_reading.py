"""Reads the folders of captures beside Blender's main thread, since small videos are decoded for that."""

from pathlib import Path

import bpy

from .. import redrawing
from ..engine.errors import FrogError
from ..tasks.background_task import BackgroundTask, Ended
from . import capture_summary, torch_environment
from .capture_summary import CaptureSummary


class CaptureReading(BackgroundTask):
    """One folder; its result is the summary of it.

    Nothing stops one that has begun; what it finds may be left alone.

    Attributes:
        folder: an absolute path.
        stamp: of the folder, from before it was read.
        layout: what the user says of its images' names.
    """

    what = "reading of the capture"
    quit_seconds = 2.0

    def __init__(self, folder: str) -> None:
        super().__init__()
        torch_environment.add_environment()  # may have OpenCV and PyAV, which read footage
        self.folder = self.slot = self.where = folder
        self.stamp, self.layout = capture_summary.stamp(folder), bpy.context.scene.frog.layout

    def work(self) -> CaptureSummary:
        return capture_summary.read(Path(self.folder), self.layout)

    def conclude(self, ended: Ended) -> None:
        """``read`` returns errors, but for memory and bugs."""
        self.result = ended.result or CaptureSummary(error=ended.error)


def read(folder: str) -> CaptureSummary | None:
    """Reads a folder and shows what is in it.

    Returns:
        The summary, or None in a window, where it is read beside the main thread and shown when it is there.
    """
    if bpy.app.background or not folder:
        reading = CaptureReading(folder)
        return show(folder, reading.work() if folder else CaptureSummary(), reading.stamp)
    read_beside(folder)
    return None


def read_beside(folder: str) -> None:
    """Starts reading a folder, which is shown when it is read. One that is being read is read again."""
    reading = CaptureReading(folder)
    reading.on_finished = lambda summary: show(folder, summary, reading.stamp)
    try:
        reading.start().show()
    except FrogError as error:
        show(folder, CaptureSummary(error=str(error)), reading.stamp)


def is_reading(folder: str) -> bool:
    """Whether a folder is being read."""
    return CaptureReading.is_any_running(folder)


def show(folder: str, summary: CaptureSummary, stamp: object) -> CaptureSummary:
    """Stores a summary and shows it where its folder is a scene's capture."""
    capture_summary.store(folder, summary, stamp)
    redrawing.viewports()  # where the rig is drawn, and the sidebars
    return summary
