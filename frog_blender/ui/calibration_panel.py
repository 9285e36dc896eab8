"""The Train panel's part about calibration, and its sub-panels about the cameras and their clocks."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..engine.capture.calibration.landmark_file import landmark_file
from ..tasks.calibration import CalibrationTask
from ..tasks.clocks import CameraClock
from . import capture_summary, contact_sheet, preview_image, report_images, torch_environment
from .capture_summary import CaptureSummary
from .clicked_points import FILE
from .sidebar_panel import SidebarPanel
from .text import wrapped_label


def draw_calibration(
    layout: bpy.types.UILayout, folder: Path, summary: CaptureSummary, context: bpy.types.Context
) -> None:
    """Draws the running calibration, the end of the last one of this folder, and the button for raw footage."""
    task = CalibrationTask.current()
    if task is not None and task.is_running:
        _draw_progress(layout, task, folder, context)
        return
    if task is not None and task.folder == folder:
        _draw_end(layout, task, context)
    if summary.raw_footage:
        needed = torch_environment.calibration_needed()
        if needed:
            wrapped_label(layout, needed, context, icon="ERROR")
            torch_environment.draw_calibration_installation(layout)
        row = layout.row()
        row.scale_y = 1.5
        row.enabled = not needed
        row.operator("frog.calibrate", icon="CAMERA_DATA")
        _draw_points(layout, folder, bool(needed))


def _draw_points(layout: bpy.types.UILayout, folder: Path, is_lacking: bool) -> None:
    """Draws the buttons for cameras that cannot be found otherwise."""
    row = layout.row(align=True)
    row.operator("frog.click_points", icon="PIVOT_CURSOR")
    if (folder / FILE).is_file():
        row = row.row(align=True)
        row.enabled = not is_lacking
        row.operator("frog.calibrate_from_points")


def _draw_progress(layout: bpy.types.UILayout, task: CalibrationTask, folder: Path, context: bpy.types.Context) -> None:
    if task.folder != folder:
        wrapped_label(layout, f"Calibrating {task.folder.name}", context)
    doing = "Cancelling" if task.is_stopping else task.progress.sentence
    layout.progress(factor=task.progress.fraction, text=doing)
    layout.operator("frog.cancel_calibration", icon="CANCEL")


def _draw_end(layout: bpy.types.UILayout, task: CalibrationTask, context: bpy.types.Context) -> None:
    if task.error:
        wrapped_label(layout, task.error, context, icon="QUESTION" if task.is_refused else "ERROR")
        if task.is_refused and landmark_file() is None:
            torch_environment.draw_landmarks(layout)  # the refusal says what for
    elif task.is_cancelled:
        wrapped_label(layout, "Cancelled. The next calibration continues with what was done.", context, icon="CANCEL")
    outcome = task.result
    if outcome is None:
        return
    wrapped_label(layout, f"Calibrated: {outcome.cameras.name}", context, icon="CHECKMARK")
    if outcome.given_kept:
        sentence = "The calibration that was there is kept. What was found lies beside it."
        wrapped_label(layout, sentence, context, icon="INFO")
        draw_choice(layout, _summary(context))
    for warning in outcome.warnings:
        wrapped_label(layout, warning, context, icon="INFO")
    preview_image.draw(layout, context, report_images.rig_name(task.folder))
    if outcome.page.is_file():
        layout.operator("wm.path_open", text="Open Report", icon="TEXT").filepath = str(outcome.page)


def draw_choice(layout: bpy.types.UILayout, summary: CaptureSummary | None) -> None:
    """Draws what makes the other calibration of a folder the one in use."""
    if summary is None or CalibrationTask.is_any_running():
        return
    if summary.found is not None:
        layout.operator("frog.use_found_cameras", icon="CHECKMARK")
    if summary.given is not None:
        layout.operator("frog.use_given_cameras", icon="LOOP_BACK")


class FROG_PT_cameras(SidebarPanel, bpy.types.Panel):
    """One image of each camera, and the rig."""

    bl_label = "Cameras"
    bl_parent_id = "FROG_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        summary = _summary(context)
        return summary is not None and bool(summary.capture is not None or summary.raw_footage)

    def draw(self, context: bpy.types.Context) -> None:
        layout, summary = self.layout, _summary(context)
        if summary is not None and summary.capture is not None:
            layout.prop(context.scene.frog, "show_rig")
        _draw_contact_sheet(layout, context)
        is_filmed = summary is not None and summary.capture is not None and summary.has_videos
        if is_filmed and not CalibrationTask.is_any_running():
            layout.operator("frog.calibrate", text="Calibrate Again", icon="CAMERA_DATA")
            draw_choice(layout, summary)


def _draw_contact_sheet(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    images = contact_sheet.shown(bpy.path.abspath(context.scene.frog.capture_folder))
    if images is None:
        layout.operator("frog.show_contact_sheet", icon="IMAGE_REFERENCE")
        return
    if images.problem:
        wrapped_label(layout, images.problem, context, icon="ERROR")
    elif images.is_running:
        layout.label(text=f"Decoding: {len(images.names)} of {images.total}", icon="TIME")
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    for name in images.names:
        column = grid.column(align=True)
        column.template_icon(preview_image.icon_id(contact_sheet.icon_name(name)), scale=6.0)
        column.label(text=name)


class FROG_PT_synchronization(SidebarPanel, bpy.types.Panel):
    """When each camera began to film, and how fast its clock runs."""

    bl_label = "Synchronization"
    bl_parent_id = "FROG_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        summary = _summary(context)
        return summary is not None and summary.clocks is not None

    def draw(self, context: bpy.types.Context) -> None:
        summary = _summary(context)
        if summary is None or summary.clocks is None:
            return
        layout, clocks = self.layout, summary.clocks
        column = layout.column(align=True)
        for clock in clocks.clocks:
            row = column.row(align=True)
            row.label(text=clock.name)
            row.label(text=described(clock))
            if clocks.is_own:
                operator = row.operator("frog.edit_clock", text="", icon="GREASEPENCIL")
                operator.camera, operator.offset, operator.rate = clock.name, clock.offset, clock.rate
        if not clocks.is_own:
            sentence = f"{clocks.path.name} was given, so it is not changed here."
            if clocks.found is not None:
                sentence += f" What was found lies beside it in {clocks.found.name}."
            wrapped_label(layout, sentence, context, icon="INFO")
        preview_image.draw(layout, context, report_images.curves_name(clocks.path.parent))


def described(clock: CameraClock) -> str:
    """A clock in a row of the panel: ``+0.133 s``, with the rate where it is not 1."""
    rate = f", x {clock.rate:.5f}" if clock.rate != 1.0 else ""
    return f"{clock.offset:+.3f} s{rate}"


def _summary(context: bpy.types.Context) -> CaptureSummary | None:
    folder = context.scene.frog.capture_folder
    return capture_summary.known(bpy.path.abspath(folder)) if folder else None


_CLASSES = (FROG_PT_cameras, FROG_PT_synchronization)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
