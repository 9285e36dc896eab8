"""The panel Train of the FRoG tab: a capture in, a trained scene out, and how that stands."""

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
from . import capture_summary, preferences, presets, preview_image, refreshing, training_time
from .text import duration, sentence


class FROG_PT_train(bpy.types.Panel):
    """Capture folder in, trained scene out."""

    bl_label = "Train"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"

    def draw_header_preset(self, _context: Any) -> None:
        presets.draw_button(self)

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.frog
        layout.prop(settings, "capture_folder")
        if settings.capture_folder:
            _draw_capture(layout, bpy.path.abspath(settings.capture_folder), context)
        layout.prop(settings, "output_path")
        layout.prop(settings, "recipe")
        layout.prop(settings, "device")
        layout.prop(settings, "import_when_done")
        _draw_start(layout, settings, context)
        task = runner.current()
        if task is not None:
            _draw_training(layout, task, settings, context)


class FROG_PT_train_advanced(bpy.types.Panel):
    """What a recipe leaves open."""

    bl_label = "Advanced"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"
    bl_parent_id = "FROG_PT_train"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("capacity", "steps", "image_scale", "holdout_frames"):
            layout.prop(context.scene.frog, name)


def _draw_capture(layout: Any, folder: str, context: Any) -> None:
    summary = capture_summary.known(folder)
    if capture_summary.is_outdated(folder):
        refreshing.soon(folder, partial(capture_summary.inspect, folder))
    if summary is None:  # a file that was just opened: looking takes time, so the user says when
        layout.operator("frog.inspect_capture", icon="VIEWZOOM")
        return
    box = layout.box()
    column = box.column(align=True)
    for line in summary.lines:
        sentence(column, line, context)
    for warning in summary.warnings:
        sentence(box, warning, context, icon="INFO")
    if summary.error:
        sentence(box, summary.error, context, icon="ERROR")
        box.operator("frog.inspect_capture", text="Check Again", icon="FILE_REFRESH")


def _draw_start(layout: Any, settings: Any, context: Any) -> None:
    """What a training would take, and the buttons that begin one."""
    if runner.is_running():
        return
    summary = capture_summary.known(bpy.path.abspath(settings.capture_folder)) if settings.capture_folder else None
    if summary is not None and summary.capture is not None:
        sentence(layout, training_time.expected(settings, summary.capture), context, icon="TIME")
    needed = preferences.torch_needed()
    if needed:
        sentence(layout, needed, context, icon="ERROR")
    row = layout.row()
    row.scale_y = 1.5
    row.enabled = not needed
    row.operator("frog.train", icon="PLAY")
    if can_resume(settings):
        row.operator("frog.train", text="Resume", icon="FRAME_NEXT").resume = True


def _draw_training(layout: Any, task: runner.TrainingTask, settings: Any, context: Any) -> None:
    """The training that runs, or the last one that ran."""
    box, state = layout.box(), task.state
    _draw_progress(box, task, context)
    if state.result is not None:
        _draw_result(box, state, state.result, context)
    _draw_figures(box, state, context)
    for line in state.capacity:
        sentence(box, line, context, icon="MOD_DECIM")
    for warning in state.warnings[-3:]:
        sentence(box, warning, context, icon="INFO")
    if preview_image.icon_id():
        # As wide as the sidebar: the image lies in a square of this many rows.
        rows = context.region.width / (20 * context.preferences.system.ui_scale) - 3 if context.region else 8
        box.template_icon(preview_image.icon_id(), scale=min(max(rows, 6.0), 16.0))
    if state.running:
        box.prop(settings, "preview_camera")


def _draw_progress(box: Any, task: runner.TrainingTask, context: Any) -> None:
    """How far it is, or how it ended; and the buttons that hold and end it."""
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
        sentence(box, state.error, context, icon="ERROR")
    elif state.cancelled:
        text = f"Cancelled at step {state.step:,}." if state.step else "Cancelled before the first step."
        box.label(text=text, icon="CANCEL")
    else:
        box.label(text=f"Finished in {duration(state.seconds)}.", icon="CHECKMARK")


def _draw_result(box: Any, state: TrainingState, result: Path, context: Any) -> None:
    """Where the scene is, what became of it here, and the button that follows."""
    sentence(box, f"Saved: {result}", context, icon="FILE_TICK")
    if state.running:
        return
    if state.note:
        sentence(box, state.note, context, icon="INFO")
    if not plays(context.scene, result):
        row = box.row()
        row.operator_context = "EXEC_DEFAULT"  # the file is known: no file browser
        row.operator("import_scene.frog", text="Import", icon="IMPORT").filepath = str(result)
    elif not is_set_up(context.scene):
        box.operator("frog.set_up_scene", icon="SCENE_DATA")


def _draw_figures(box: Any, state: TrainingState, context: Any) -> None:
    column = box.column(align=True)
    if state.running and not state.stage and state.step:
        column.label(text=f"Time left: {duration(state.seconds_left)}")
    if state.loss is not None:
        column.label(text=f"Loss: {state.loss:.4f}")
    if state.psnr is not None:
        sentence(column, f"PSNR: {state.psnr:.2f} dB ({state.psnr_split or 'training'} views)", context)
    if state.gaussians:
        still = state.gaussians - state.moving
        resting = f" ({state.moving:,} move)" if still and state.capacity else ""
        column.label(text=f"Gaussians: {state.gaussians:,}{resting}")


_CLASSES = (FROG_PT_train, FROG_PT_train_advanced)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
