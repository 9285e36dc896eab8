"""Calibrate Cameras: raw videos become a capture, in the background."""

# mypy: disable-error-code="valid-type"

import os
from pathlib import Path

import bpy

from ..engine.capture.calibration.pipeline import Outcome
from ..engine.capture.readers.footage import is_recording
from ..engine.errors import FrogError
from ..engine.whole_progress import Standing
from ..properties import switch
from ..tasks.calibration import CalibrationTask
from ..ui import capture_summary, torch_environment
from .bases import FrogOperator, TaskOperator


class FROG_OT_calibrate(FrogOperator, bpy.types.Operator):
    """Find where the cameras stood and when each began to film, in the background. No file that is there is changed"""

    bl_label = "Calibrate Cameras"

    are_standing: switch("All Stand", "All cameras stand, whatever moves before them", options={"SKIP_SAVE"})
    in_step: switch("In Step", "All films began at the same time: none is synchronized", options={"SKIP_SAVE"})

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        return "A calibration is already running." if CalibrationTask.is_any_running() else ""

    def act(self, context: bpy.types.Context) -> None:
        settings = context.scene.frog
        folder = footage_folder(settings.capture_folder)
        if needed := torch_environment.calibration_needed():
            raise FrogError(needed)
        layout = "standing" if self.are_standing else settings.layout
        task = CaptureCalibration(folder, layout, in_step=self.in_step)
        task.on_finished = task.open
        task.begin()


class FROG_OT_cancel_calibration(TaskOperator, bpy.types.Operator):
    """Stop the calibration. Stages that are done are kept, so that the next one continues there"""

    kind = CalibrationTask


def footage_folder(stored: str) -> Path:
    """The folder of the panel's setting; FrogError if there is none."""
    if not stored:
        raise FrogError("No capture is selected. Choose the folder with the videos to calibrate.")
    folder = Path(bpy.path.abspath(stored))
    if not os.path.isdir(folder) and not is_recording(folder):  # false, not an error, without permission
        raise FrogError(f"{folder}: found no such folder, expected one with a video of each camera.")
    return folder


class CaptureCalibration(CalibrationTask):
    """A calibration, and then the capture that it made of a folder of footage.

    The capture is read on the worker thread, because small videos are decoded for that.
    """

    summary = capture_summary.CaptureSummary()
    stamp: object = None
    """Of the folder, from before it was read."""

    def work(self) -> Outcome:
        outcome = super().work()
        self.tell_whole(Standing("Opening the capture", 1.0, 0.0))
        self.stamp, self.summary = capture_summary.stamp(str(self.folder)), capture_summary.read(self.folder)
        return outcome

    def open(self, _outcome: Outcome) -> None:
        """Shows the capture in every scene that names it,"""
        for scene in bpy.data.scenes:
            stored = scene.frog.capture_folder
            named = bpy.path.abspath(stored) if stored else ""
            if named and Path(os.path.normpath(named)) == Path(os.path.normpath(self.folder)):
                capture_summary.store(named, self.summary, self.stamp)
