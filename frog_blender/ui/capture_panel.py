"""The Capture panel of the FRoG tab: what is trained from, what was found in it, and how its cameras were found."""

from functools import partial
from pathlib import Path

import bpy

from ..engine.capture.calibration.report import PAGE
from ..engine.capture.readers.pairing import Clock
from ..scene_capture import placing
from ..tasks.calibration import CalibrationTask
from ..tasks.scene_capture import SceneCaptureTask
from . import capture_reading, capture_summary, refreshing
from . import torch_environment as environment
from .capture_summary import CaptureSummary
from .sidebar_panel import SidebarPanel, SubPanel, draw_progress, split, wrapped_label


def _folder(context: bpy.types.Context) -> str:
    """The capture's folder; empty for none."""
    return bpy.path.abspath(context.scene.frog.capture_folder)


class FROG_PT_capture(SidebarPanel, bpy.types.Panel):
    """The folder of a capture, what is in it, and what it lacks."""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        layout, folder, settings = split(self.layout), _folder(context), context.scene.frog
        layout.prop(settings, "capture_folder", text="")
        if folder:
            _draw_capture(layout, folder)
            summary = capture_summary.of(settings)
            is_asked_for = "--layout" in " ".join((summary.error, *summary.warnings))
            if summary.raw_footage or settings.layout != "auto" or is_asked_for:
                layout.prop(settings, "layout")
        else:
            wrapped_label(layout, "Choose a folder with videos or images, or drop videos into the viewport.")


def _draw_capture(layout: bpy.types.UILayout, folder: str) -> None:
    summary = capture_summary.known(folder)
    is_being_read = capture_reading.is_reading(folder)
    if not is_being_read and capture_summary.is_outdated(folder):
        refreshing.soon(folder, partial(capture_reading.read, folder))
    if is_being_read:
        layout.label(text="Reading the capture", icon="TIME")
    elif summary is None:  # a file was just opened: reading takes time, so the user decides
        layout.operator("frog.inspect_capture", icon="VIEWZOOM")
    if summary is None:
        return
    box = layout.box()
    column = box.column(align=True)
    for line in summary.lines:
        wrapped_label(column, line)
    for warning in summary.warnings:
        wrapped_label(box, warning, icon="INFO")
    _draw_calibration(box, Path(folder), summary)
    if summary.error:
        wrapped_label(box, summary.error, icon="ERROR")
        if environment.lacks_films():
            environment.draw_calibration_installation(box)
        box.operator("frog.inspect_capture", text="Check Again", icon="FILE_REFRESH")


def _draw_calibration(layout: bpy.types.UILayout, folder: Path, summary: CaptureSummary) -> None:
    """Draws the running calibration, the end of the last one of this folder, and the buttons for raw footage."""
    task = CalibrationTask.current()
    if task is not None and task.is_running:
        if task.folder != folder:
            wrapped_label(layout, f"Calibrating {task.folder.name}")
        draw_progress(layout, task)
        layout.operator("frog.cancel_calibration", icon="CANCEL")
        return
    if task is not None and task.folder == folder:
        _draw_calibrated(layout, task, summary)
    if not summary.raw_footage:
        return
    needed = environment.calibration_needed()
    if needed:
        wrapped_label(layout, needed, icon="ERROR")
        environment.draw_calibration_installation(layout)
    row = layout.row(align=True)
    row.scale_y, row.enabled = 1.5, not needed
    row.operator("frog.calibrate", icon="CAMERA_DATA")
    row.operator("frog.calibrate", text="", icon="PINNED").are_standing = True
    row.operator("frog.calibrate", text="", icon="TIME").in_step = True


def _draw_calibrated(layout: bpy.types.UILayout, task: CalibrationTask, summary: CaptureSummary) -> None:
    """Draws how a calibration ended."""
    if task.error:
        wrapped_label(layout, task.error, icon="QUESTION" if task.is_refused else "ERROR")
    elif task.is_cancelled:
        wrapped_label(layout, "Cancelled. The next calibration continues with what was done.", icon="CANCEL")
    outcome = task.result
    if outcome is None:
        return
    wrapped_label(layout, f"Calibrated: {outcome.cameras.name}", icon="CHECKMARK")
    if outcome.given_kept:
        wrapped_label(layout, "The calibration that was there is kept. What was found lies beside it.", icon="INFO")
        _draw_found(layout, summary)
    for warning in outcome.warnings:
        wrapped_label(layout, warning, icon="INFO")
    _draw_report(layout, outcome.page)


def _draw_report(layout: bpy.types.UILayout, page: Path) -> None:
    """Draws what opens a calibration's report, which has the curves of clocks, where there is one."""
    if page.is_file():
        layout.operator("wm.path_open", text="Open Report", icon="TEXT").filepath = str(page)


def _draw_found(layout: bpy.types.UILayout, summary: CaptureSummary) -> None:
    """Draws what makes a calibration that was found the one in use."""
    if summary.found is not None:
        layout.operator("frog.use_found_cameras", icon="CHECKMARK")


class _OfCapture(SubPanel):
    """Base of the panel's sub-panels."""

    bl_parent_id = "FROG_PT_capture"


class FROG_PT_masks(_OfCapture, bpy.types.Panel):
    """Which parts of the images are trained on."""

    bl_label = "Masks"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(_folder(context))

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = split(self.layout), context.scene.frog
        layout.prop(settings, "masks")
        if settings.masks == "key":
            row = layout.row(align=True)
            row.prop(settings, "key_color")
            row.prop(settings, "key_tolerance", text="")


class FROG_PT_scene_capture(_OfCapture, bpy.types.Panel):
    """A capture of the open scene: a rig of cameras around a box, and what is rendered through it."""

    bl_label = "From This Scene"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = split(self.layout), context.scene.frog.rig
        layout.prop(settings, "shape")
        layout.prop(settings, "count")
        if settings.shape == "ARC":
            layout.prop(settings, "arc")
        layout.prop(settings, "lens")
        if settings.box is not None:
            layout.prop(settings, "box")
        row = layout.row(align=True)
        row.operator("frog.place_rig", icon="OUTLINER_OB_CAMERA")
        if settings.box is not None:
            row.operator("frog.place_rig", text="Fit to Selection", icon="CUBE").fit = True
            row.operator("frog.remove_rig", text="", icon="X")
        if cameras := placing.cameras_of(settings):
            _draw_rendering(layout, context.scene, len(cameras))


def _draw_rendering(layout: bpy.types.UILayout, scene: bpy.types.Scene, cameras: int) -> None:
    """Draws what a rig is rendered with, or the rendering."""
    settings, task = scene.frog.rig, SceneCaptureTask.current()
    done = f"{task.progress.done:,} of {task.progress.total:,} images" if task is not None else ""
    if task is not None and task.is_running:
        draw_progress(layout, task)
        layout.operator("frog.cancel_scene_capture", icon="CANCEL")
        return
    layout.prop(settings, "size")
    layout.prop(settings, "folder")
    frames = len(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    sentence = f"{cameras * frames:,} images: {frames:,} frames of {cameras:,} cameras"
    wrapped_label(layout, sentence, icon="RENDER_STILL")
    row = layout.row()
    row.scale_y = 1.5
    row.operator("frog.capture_scene", icon="RENDER_ANIMATION")
    if task is None:
        return
    if task.error:
        wrapped_label(layout, task.error, icon="ERROR")
    elif task.is_cancelled:
        wrapped_label(layout, f"Cancelled at {done}. Render Capture continues there.", icon="CANCEL")
    else:
        sentence = f"{task.progress.total:,} images are in {task.request.folder.name}. Train FRoG learns from them."
        wrapped_label(layout, sentence, icon="CHECKMARK")


class FROG_PT_cameras(_OfCapture, bpy.types.Panel):
    """The rig, and its calibration."""

    bl_label = "Cameras"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return capture_summary.of(context.scene.frog).capture is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, summary = self.layout, capture_summary.of(context.scene.frog)
        layout.prop(context.scene.frog, "show_rig")
        if summary.has_videos and not CalibrationTask.is_any_running():
            layout.operator("frog.calibrate", text="Calibrate Again", icon="CAMERA_DATA")
            _draw_found(layout, summary)


class FROG_PT_synchronization(_OfCapture, bpy.types.Panel):
    """When each camera began to film, and how fast its clock runs."""

    bl_label = "Synchronization"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return capture_summary.of(context.scene.frog).clocks is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, summary = self.layout, capture_summary.of(context.scene.frog)
        clocks = summary.clocks
        assert clocks is not None  # see poll
        column = layout.column(align=True)
        for name, clock in clocks.clocks.items():
            row = column.row(align=True)
            row.label(text=name)
            row.label(text=_told(clock))
            if clocks.is_own:
                operator = row.operator("frog.edit_clock", text="", icon="GREASEPENCIL")
                operator.camera, operator.offset, operator.rate = name, clock.offset, clock.rate
        if not clocks.is_own:
            sentence = f"{clocks.path.name} was given, so it is not changed here."
            if summary.found is not None:
                sentence += f" What was found lies beside it in {summary.found.name}."
            wrapped_label(layout, sentence, icon="INFO")
        _draw_report(layout, clocks.path.with_name(PAGE))


def _told(clock: Clock) -> str:
    """A clock in a row of the panel: ``+0.133 s``, with the rate where it is not 1."""
    rate = f", x {clock.rate:.5f}" if clock.rate != 1.0 else ""
    return f"{clock.offset:+.3f} s{rate}"
