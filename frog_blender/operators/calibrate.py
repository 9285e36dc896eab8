"""Calibrate Cameras: raw videos become a capture, in the background."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..engine.errors import FrogError
from ..engine.io.child_process import Progress
from ..tasks.calibration import CalibrationTask, Calibrator, calibrator_of
from ..ui import capture_summary, report_images, torch_environment
from .bases import CancelOperator, FrogOperator

if TYPE_CHECKING:
    from ..engine.capture.calibration.pipeline import Outcome


class FROG_OT_calibrate(FrogOperator, bpy.types.Operator):
    """Find where the cameras stood and when each began to film, in the background. No file that is there is changed"""

    bl_idname = "frog.calibrate"
    bl_label = "Calibrate Cameras"

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        return "A calibration is already running." if CalibrationTask.is_any_running() else ""

    def act(self, context: bpy.types.Context) -> str:
        return begin_calibration(context.scene)


class FROG_OT_cancel_calibration(CancelOperator, bpy.types.Operator):
    """Stop the calibration. Stages that are done are kept, so that the next one continues there"""

    bl_idname = "frog.cancel_calibration"
    kind = CalibrationTask


def begin_calibration(scene: bpy.types.Scene, points: str = "") -> str:
    """Starts the calibration of a scene's capture; by a file of points in its folder if one is named. See ``act``."""
    folder = footage_folder(scene.frog.capture_folder)
    needed = torch_environment.calibration_needed()
    if needed:
        raise FrogError(needed)
    opening = CaptureOpening(folder, calibrator_of(folder, folder / points if points else None))
    CalibrationTask(folder, opening.calibrate, opening.show).begin()
    return ""


def footage_folder(stored: str) -> Path:
    """The folder of the panel's setting; FrogError if there is none."""
    if not stored:
        raise FrogError("No capture is selected. Choose the folder with the videos to calibrate.")
    folder = Path(bpy.path.abspath(stored))
    if not os.path.isdir(folder):  # false, not an error, without permission
        raise FrogError(f"{folder}: found no such folder, expected one with a video of each camera.")
    return folder


class CaptureOpening:
    """A calibration, and then the capture that it made of a folder of footage.

    The capture is read on the worker thread, because small videos are decoded for that.
    """

    def __init__(self, folder: Path, calibrator: Calibrator) -> None:
        self.folder, self._calibrator = folder, calibrator
        self._summary, self._stamp = capture_summary.CaptureSummary(), capture_summary.stamp(str(folder))

    def calibrate(self, progress: Progress, cancelled: Callable[[], bool]) -> "Outcome":
        """For the worker thread."""
        outcome = self._calibrator(progress, cancelled)
        progress("opening the capture", 0, 1)
        self._stamp, self._summary = capture_summary.stamp(str(self.folder)), capture_summary.read(self.folder)
        return outcome

    def show(self, _outcome: "Outcome") -> None:
        """For the main thread: shows the capture in every scene that names it, and draws what was found."""
        for scene in bpy.data.scenes:
            stored = scene.frog.capture_folder
            named = bpy.path.abspath(stored) if stored else ""
            if named and Path(os.path.normpath(named)) == Path(os.path.normpath(self.folder)):
                capture_summary.store(named, self._summary, self._stamp)
                report_images.show(self.folder, self._summary.capture)
