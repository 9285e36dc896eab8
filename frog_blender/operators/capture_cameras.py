"""The cameras of the capture to train from: corrections of their clocks, and which calibration is used."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..engine.capture.calibration.camera_files import use_found
from ..engine.capture.readers.calibrated_videos import MAX_OFFSET, RATES
from ..engine.capture.readers.pairing import Clock
from ..engine.errors import in_words, listed
from ..properties import number
from ..tasks.calibration import CalibrationTask
from ..tasks.clocks import write_clock
from ..ui import capture_reading, capture_summary
from ..ui.sidebar_panel import split
from .bases import FrogOperator


class FROG_OT_edit_clock(FrogOperator, bpy.types.Operator):
    """Correct when this camera began to film. The calibration that FRoG wrote is changed, never one that was given"""

    bl_label = "Correct Clock"

    camera: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    offset: number(
        "Offset",
        "Seconds after the capture's beginning at which this camera's film begins",
        min=-MAX_OFFSET,
        max=MAX_OFFSET,
        precision=4,
        step=1,
        options={"SKIP_SAVE"},
    )
    rate: number(
        "Rate",
        "Seconds of the capture for each second of this camera's film; 1 for a clock that runs right",
        1.0,
        min=RATES[0],
        max=RATES[1],
        precision=6,
        step=0.001,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=400, title=f"Clock of {self.camera}")

    def draw(self, context: bpy.types.Context) -> None:
        layout = split(self.layout)
        layout.prop(self, "offset")
        layout.prop(self, "rate")

    def act(self, context: bpy.types.Context) -> None:
        folder = bpy.path.abspath(context.scene.frog.capture_folder)
        # As typed: Blender's numbers are of single precision, so that 0.1 reads 0.10000000149.
        typed = Clock(*(float(f"{value:.7g}") for value in (self.offset, self.rate)))
        write_clock(Path(folder), self.camera, typed)
        summary = capture_reading.read(folder)
        if summary is not None and summary.error:
            self.report({"WARNING"}, summary.error)


class FROG_OT_use_found_cameras(FrogOperator, bpy.types.Operator):
    """Train from the cameras that were found from now on. The given calibration is kept beside them"""

    bl_label = "Use Found Cameras"

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        summary, is_free = capture_summary.of(context.scene.frog), not CalibrationTask.is_any_running()
        # Of a capture that was not read, or cannot be, only the folder tells: ``act`` says what is not there.
        is_there = summary.capture is None or summary.found is not None
        is_ready = is_there and is_free and context.scene.frog.capture_folder
        return "" if is_ready else "There is no other calibration beside the one in use, or a calibration is running."

    def act(self, context: bpy.types.Context) -> str:
        folder = bpy.path.abspath(context.scene.frog.capture_folder)
        with in_words(f"{folder}: the calibration could not be changed"):
            used, kept = use_found(Path(folder))
        context.scene.frog.capture_folder = context.scene.frog.capture_folder  # opens it, and shows its rig
        summary = capture_summary.known(folder)
        if summary is not None and summary.error and not capture_reading.is_reading(folder):
            self.report({"WARNING"}, summary.error)
            return ""
        return f"{used.name} is used now. What was used before is {listed([path.name for path in kept])}."
