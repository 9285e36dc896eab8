"""The Train panel of the FRoG tab."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ..scene_import.capture_objects import plays
from ..scene_import.scene_setup import is_set_up
from ..training_task import runner
from ..training_task.request import can_resume
from ..training_task.state import TrainingState
from . import calibration_panel, capture_summary, preferences, presets, preview_image, refreshing, training_time
from .text import duration, wrapped_label


class FROG_PT_train(bpy.types.Panel):
    """Settings, start and progress of a training."""

    bl_label = "Train"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        presets.draw_button(self)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.frog
        layout.prop(settings, "capture_folder")
        if settings.capture_folder:
            _draw_capture(layout, bpy.path.abspath(settings.capture_folder), context)
            _draw_masks(layout, settings)
        layout.prop(settings, "output_path")
        layout.prop(settings, "recipe")
        layout.prop(settings, "device")
        layout.prop(settings, "import_when_done")
        _draw_start(layout, settings, context)
        task = runner.current()
        if task is not None:
            _draw_training(layout, task, settings, context)


class FROG_PT_train_advanced(bpy.types.Panel):
    """Advanced training settings."""

    bl_label = "Advanced"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"
    bl_parent_id = "FROG_PT_train"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("capacity", "steps", "image_scale", "holdout_frames"):
            layout.prop(context.scene.frog, name)


def _draw_capture(layout: bpy.types.UILayout, folder: str, context: bpy.types.Context) -> None:
    summary = capture_summary.known(folder)
    if capture_summary.is_outdated(folder):
        refreshing.soon(folder, partial(capture_summary.inspect, folder))
    if summary is None:  # a file was just opened: reading takes time, so the user decides
        layout.operator("frog.inspect_capture", icon="VIEWZOOM")
        return
    box = layout.box()
    column = box.column(align=True)
    for line in summary.lines:
        wrapped_label(column, line, context)
    for warning in summary.warnings:
        wrapped_label(box, warning, context, icon="INFO")
    calibration_panel.draw_calibration(box, Path(folder), summary, context)
    if summary.error:
        wrapped_label(box, summary.error, context, icon="ERROR")
        box.operator("frog.inspect_capture", text="Check Again", icon="FILE_REFRESH")


def _draw_masks(layout: bpy.types.UILayout, settings: Any) -> None:
    layout.prop(settings, "masks")
    if settings.masks == "key":
        row = layout.row(align=True)
        row.prop(settings, "key_color")
        row.prop(settings, "key_tolerance", text="")


def _draw_start(layout: bpy.types.UILayout, settings: Any, context: bpy.types.Context) -> None:
    """Draws the estimated duration and the buttons that start a training."""
    if runner.is_running():
        return
    summary = capture_summary.known(bpy.path.abspath(settings.capture_folder)) if settings.capture_folder else None
    if summary is not None and summary.capture is not None:
        wrapped_label(layout, training_time.expected(settings, summary.capture), context, icon="TIME")
    needed = preferences.torch_needed()
    if needed:
        wrapped_label(layout, needed, context, icon="ERROR")
    row = layout.row()
    row.scale_y = 1.5
    row.enabled = not needed and not (summary is not None and summary.raw_footage)
    row.operator("frog.train", icon="PLAY")
    if can_resume(settings):
        row.operator("frog.train", text="Resume", icon="FRAME_NEXT").resume = True


def _draw_training(
    layout: bpy.types.UILayout, task: runner.TrainingTask, settings: Any, context: bpy.types.Context
) -> None:
    """Draws the running training, or the last one."""
    box, state = layout.box(), task.state
    _draw_progress(box, task, context)
    if state.result is not None:
        _draw_result(box, state, state.result, context)
    _draw_figures(box, state, context)
    for line in state.capacity:
        wrapped_label(box, line, context, icon="MOD_DECIM")
    for warning in state.warnings[-3:]:
        wrapped_label(box, warning, context, icon="INFO")
    preview_image.draw(box, context)
    if state.running:
        box.prop(settings, "preview_camera")


def _draw_progress(box: bpy.types.UILayout, task: runner.TrainingTask, context: bpy.types.Context) -> None:
    """Draws the progress or result, and the buttons to pause and cancel."""
    state = task.state
    if state.running:
        text = state.stage or f"Step {state.step:,} of {state.steps:,}"
        box.progress(factor=state.fraction, text=f"Paused: {text}" if task.paused else text)
        row = box.row(align=True)
        if task.paused:
            row.operator("frog.resume_training", icon="PLAY")
        else:
            row.operator("frog.pause_training", icon="PAUSE")
        row.operator("frog.cancel_training", icon="CANCEL")
    elif state.error:
        wrapped_label(box, state.error, context, icon="ERROR")
    elif state.cancelled:
        text = f"Cancelled at step {state.step:,}." if state.step else "Cancelled before the first step."
        box.label(text=text, icon="CANCEL")
    else:
        box.label(text=f"Finished in {duration(state.seconds)}.", icon="CHECKMARK")


def _draw_result(box: bpy.types.UILayout, state: TrainingState, result: Path, context: bpy.types.Context) -> None:
    """Draws the path of the scene, what happened to it, and the next action."""
    wrapped_label(box, f"Saved: {result}", context, icon="FILE_TICK")
    if state.running:
        return
    if state.note:
        wrapped_label(box, state.note, context, icon="INFO")
    if not plays(context.scene, result):
        row = box.row()
        row.operator_context = "EXEC_DEFAULT"  # the file is known: no file browser
        row.operator("import_scene.frog", text="Import", icon="IMPORT").filepath = str(result)
    elif not is_set_up(context.scene):
        box.operator("frog.set_up_scene", icon="SCENE_DATA")


def _draw_figures(box: bpy.types.UILayout, state: TrainingState, context: bpy.types.Context) -> None:
    column = box.column(align=True)
    if state.running and not state.stage and state.step:
        column.label(text=f"Time left: {duration(state.seconds_left)}")
    if state.loss is not None:
        column.label(text=f"Loss: {state.loss:.4f}")
    if state.psnr is not None:
        wrapped_label(column, f"PSNR: {state.psnr:.2f} dB ({state.psnr_split or 'training'} views)", context)
    if state.gaussians:
        is_partly_static = state.moving < state.gaussians and state.capacity
        dynamic = f" ({state.moving:,} dynamic)" if is_partly_static else ""
        column.label(text=f"Gaussians: {state.gaussians:,}{dynamic}")


_CLASSES = (FROG_PT_train, FROG_PT_train_advanced)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
