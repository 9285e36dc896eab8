"""The cameras of the capture to train from: a contact sheet, and corrections of their clocks."""

# mypy: disable-error-code="valid-type"

from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.props import FloatProperty, StringProperty

from ..engine.capture.calibration.camera_files import found_beside, given_beside, use_found, use_given
from ..engine.errors import FrogError
from ..tasks.calibration import CalibrationTask
from ..tasks.clocks import OFFSETS, RATES, CameraClock, write_clock
from ..ui import capture_reading, capture_summary, contact_sheet, preview_image, report_images, torch_environment


class FROG_OT_show_contact_sheet(bpy.types.Operator):
    """Show the first image of each camera"""

    bl_idname = "frog.show_contact_sheet"
    bl_label = "Show Images"

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = bpy.path.abspath(context.scene.frog.capture_folder)
        summary = capture_summary.known(folder) or capture_reading.read(folder)
        if summary is None:
            self.report({"INFO"}, "The capture is being read. Show its images when the panel says what is in it.")
            return {"CANCELLED"}
        if summary.error or not folder:
            self.report({"ERROR"}, summary.error or "No capture is selected. Choose the folder with the videos.")
            return {"CANCELLED"}
        torch_environment.add_environment()  # may have OpenCV, which reads videos
        try:
            contact_sheet.show(folder, summary)
        except OSError as error:
            self.report({"ERROR"}, f"{folder}: could not be read ({error.strerror}).")
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_edit_clock(bpy.types.Operator):
    """Correct when this camera began to film. The calibration that FRoG wrote is changed, never one that was given"""

    bl_idname = "frog.edit_clock"
    bl_label = "Correct Clock"

    camera: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    offset: FloatProperty(
        name="Offset",
        description="Seconds after the capture's beginning at which this camera's film begins",
        min=-OFFSETS,
        max=OFFSETS,
        precision=4,
        step=1,
        options={"SKIP_SAVE"},
    )
    rate: FloatProperty(
        name="Rate",
        description="Seconds of the capture for each second of this camera's film; 1 for a clock that runs right",
        default=1.0,
        min=RATES[0],
        max=RATES[1],
        precision=6,
        step=0.001,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        report_images.show_curve(Path(bpy.path.abspath(context.scene.frog.capture_folder)), self.camera)
        return context.window_manager.invoke_props_dialog(self, width=400, title=f"Clock of {self.camera}")

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "offset")
        layout.prop(self, "rate")
        preview_image.draw(layout, context, report_images.ONE_CURVE)

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = bpy.path.abspath(context.scene.frog.capture_folder)
        try:
            write_clock(Path(folder), CameraClock(self.camera, _rounded(self.offset), _rounded(self.rate)))
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        summary = capture_reading.read(folder)
        if summary is not None and summary.error:
            self.report({"WARNING"}, summary.error)
        return {"FINISHED"}


class FROG_OT_use_found_cameras(bpy.types.Operator):
    """Train from the cameras that were found from now on. The given calibration is kept beside them"""

    bl_idname = "frog.use_found_cameras"
    bl_label = "Use Found Cameras"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _can_choose(cls, context, found_beside)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return _chosen(self, context, lambda folder: use_found(folder)[0])


class FROG_OT_use_given_cameras(bpy.types.Operator):
    """Train from the given calibration again. What was found is kept beside it"""

    bl_idname = "frog.use_given_cameras"
    bl_label = "Use Given Cameras"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _can_choose(cls, context, given_beside)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return _chosen(self, context, use_given)


def _can_choose(
    operator: type[bpy.types.Operator], context: bpy.types.Context, beside: Callable[[Path], Path | None]
) -> bool:
    """Whether there is another calibration, and nothing reads or writes those of the folder."""
    operator.poll_message_set("There is no other calibration beside the one in use, or a calibration is running.")
    folder = context.scene.frog.capture_folder
    if not folder or CalibrationTask.is_any_running():
        return False
    try:
        return beside(Path(bpy.path.abspath(folder))) is not None
    except (FrogError, OSError):
        return False


def _chosen(operator: bpy.types.Operator, context: bpy.types.Context, use: Callable[[Path], Path]) -> set[str]:
    """Changes the calibration and opens the capture anew."""
    folder = bpy.path.abspath(context.scene.frog.capture_folder)
    try:
        used = use(Path(folder))
    except (FrogError, OSError) as error:
        operator.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    context.scene.frog.capture_folder = context.scene.frog.capture_folder  # opens it, and shows its rig
    summary = capture_summary.known(folder)
    if summary is not None and summary.error and not capture_reading.is_reading(folder):
        operator.report({"WARNING"}, summary.error)
    else:
        operator.report({"INFO"}, f"{used.name} is used now.")
    return {"FINISHED"}


def _rounded(value: float) -> float:
    """As typed: Blender's numbers are of single precision, so that 0.1 reads 0.10000000149."""
    return float(f"{value:.7g}")


_CLASSES = (
    FROG_OT_show_contact_sheet,
    FROG_OT_edit_clock,
    FROG_OT_use_found_cameras,
    FROG_OT_use_given_cameras,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
