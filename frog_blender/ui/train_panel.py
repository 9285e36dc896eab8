"""The Train panel of the FRoG tab."""

from pathlib import Path
from typing import Any

import bpy

from ..engine.capture.capture import Capture
from ..engine.options import Option, panel_options
from ..engine.recipes import recipe
from ..engine.setting import Choice
from ..engine.training.session.time_estimate import Workload, estimate, likely_device
from ..option_properties import property_name
from ..scene_import.capture_objects import that_plays
from ..scene_import.scene_setup import is_set_up
from ..tasks.training import TrainingState, TrainingTask
from ..tasks.training_request import can_resume, can_train_longer, output_of, steps_done
from ..viewport import live
from . import capture_summary, preview_image, torch_environment, training_settings
from .sidebar_panel import SidebarPanel, SubPanel, draw_progress, draw_reason, duration, split, wrapped_label


class FROG_PT_train(SidebarPanel, bpy.types.Panel):
    """Start, progress and result of a training."""

    bl_label = "Train"

    def draw(self, context: bpy.types.Context) -> None:
        layout = split(self.layout)
        settings, task = context.scene.frog, TrainingTask.current()
        if not TrainingTask.is_any_running():
            layout.prop(settings, "recipe")
            layout.prop(settings, "output_path")
            _draw_start(layout, settings)
        if task is not None:
            _draw_training(layout, task, context.scene)


class FROG_PT_train_report(SubPanel, bpy.types.Panel):
    """What a training says in numbers, and what it left out."""

    bl_label = "Report"
    bl_parent_id = "FROG_PT_train"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        task = TrainingTask.current()
        return task is not None and task.state.step > 0

    def draw(self, context: bpy.types.Context) -> None:
        layout, task = self.layout, TrainingTask.current()
        assert task is not None  # see poll
        state = task.state
        if state.result is not None:
            wrapped_label(layout, f"Saved: {state.result}", icon="FILE_TICK")
        _draw_figures(layout, state)
        for line in state.capacity:
            wrapped_label(layout, line, icon="MOD_DECIM")


class FROG_PT_train_advanced(SubPanel, bpy.types.Panel):
    """Advanced training settings."""

    bl_label = "Advanced"
    bl_parent_id = "FROG_PT_train"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = split(self.layout), context.scene.frog
        layout.prop(settings, "import_when_done")
        layout.prop(settings, "device")
        layout.prop(settings, "capacity")
        layout.prop(settings, "length")
        if settings.length == "RECIPE":
            _draw_resolved(layout, f"{training_settings.usual_steps(settings):,} steps")
        else:
            layout.prop(settings, "steps" if settings.length == "STEPS" else "minutes")
        scale = training_settings.usual_image_scale(settings)
        _draw_choice(layout, settings, "has_image_scale", "image_scale", f"{scale:.2f} of their size")
        most = training_settings.usual_gaussians(settings)
        _draw_choice(layout, settings, "has_max_gaussians", "max_gaussians", f"{most:,} at most")
        layout.prop(settings, "holdout")
        if settings.holdout == "FRAMES":
            layout.prop(settings, "holdout_frames", text="n")
        elif settings.holdout == "CAPTURE":
            _draw_resolved(layout, _left_out(settings))
        layout.prop(settings, "pixel_offsets")


class FROG_PT_train_more(SubPanel, bpy.types.Panel):
    """Options of a training that no other panel has."""

    bl_label = "More"
    bl_parent_id = "FROG_PT_train_advanced"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = split(self.layout), context.scene.frog
        for option in panel_options():
            if option.name not in _SHOWN_ELSEWHERE and not _has_one_value(option):
                layout.prop(settings, property_name(option))


_SHOWN_ELSEWHERE = {
    *("recipe", "device", "capacity", "steps", "seconds", "scale", "max_gaussians", "holdout_frames"),
    *("pixel_offsets", "masks", "key", "layout", "preview_camera"),
}


def _has_one_value(option: Option) -> bool:
    """Whether there is nothing to choose, as of methods where the research package is not there."""
    return isinstance(option.kind, Choice) and len(option.kind.values) == 1


def _draw_choice(layout: bpy.types.UILayout, settings: Any, switch: str, name: str, usual: str) -> None:
    """Draws a check box, with the value behind it if it is on, otherwise with what holds without it."""
    layout.prop(settings, switch)
    if getattr(settings, switch):
        layout.prop(settings, name)
    else:
        _draw_resolved(layout, usual)


def _draw_resolved(layout: bpy.types.UILayout, text: str) -> None:
    """Draws what a setting comes to, where values of settings stand."""
    split = layout.split(factor=0.4)
    split.label(text="")
    split.label(text=text)


def _left_out(settings: Any) -> str:
    """What is not trained on by default, in a few words."""
    capture = capture_summary.of(settings).capture
    if capture is None:
        return "not known yet"
    return ", ".join(sorted(capture.test_cameras)) or ("some frames" if capture.test_frames else "nothing")


def _expected_time(settings: Any, capture: Capture) -> str:
    """How long the training will take, as far as that is known. Neither decodes nor imports torch."""
    scale = settings.image_scale or capture.usual_scale
    work = Workload.of(capture, recipe(settings.recipe), settings.steps or None, scale)
    return f"{estimate(work, likely_device(settings.device), 60.0 * settings.minutes or None)}."


def _draw_start(layout: bpy.types.UILayout, settings: Any) -> None:
    """Draws the buttons that start a training, and how long it will take."""
    capture = capture_summary.of(settings).capture
    needed = torch_environment.torch_needed()
    wrapped_label(layout, needed, icon="ERROR")
    if needed:
        torch_environment.draw_torch_installation(layout)
    row = layout.row()
    row.scale_y = 1.5
    row.operator("frog.train", icon="PLAY")
    if capture is not None:  # below: its lines, which change, move no button
        wrapped_label(layout, _expected_time(settings, capture), icon="TIME")
    if not needed and not capture_summary.of(settings).error:  # which the panel above tells
        draw_reason(layout, "FROG_OT_train")
    if can_resume(settings):
        row.operator("frog.train", text="Resume", icon="FRAME_NEXT").resume = True
        task = TrainingTask.current()
        if task is None or task.result != output_of(settings):  # else the panel says how that ended
            sentence = f"The training of {output_of(settings).name} was interrupted at step {steps_done(settings):,}."
            wrapped_label(layout, sentence, icon="INFO")
    elif can_train_longer(settings):
        row.operator("frog.train_longer", icon="FRAME_NEXT")


def _draw_training(layout: bpy.types.UILayout, task: TrainingTask, scene: bpy.types.Scene) -> None:
    """Draws the running training, or the last one."""
    box, state = layout.box(), task.state
    _draw_progress(box, task)
    if task.result is not None:
        _draw_result(box, task, task.result, scene)
    for warning in state.warnings[-3:]:
        wrapped_label(box, warning, icon="INFO")
    if state.result is None or not that_plays(scene, state.result):  # else the viewport shows more
        preview_image.draw(box)
    if task.is_running:
        box.prop(scene.frog, "preview_camera", placeholder=capture_summary.of(scene.frog).previewed)
        if task.live is not None:
            _draw_live(box, scene)


def _draw_live(box: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draws whether viewports show the training's scene, and how to look at it."""
    if elsewhere := live.elsewhere(scene):
        wrapped_label(box, elsewhere, icon="INFO")
        box.operator("frog.show_live_here", icon="HIDE_OFF")
        return
    box.prop(scene.frog, "show_live")
    box.operator("frog.look_live", icon="VIEW_CAMERA")


def _draw_progress(box: bpy.types.UILayout, task: TrainingTask) -> None:
    """Draws the progress or result, and the buttons to pause, cancel and dismiss."""
    state = task.state
    if task.is_running:
        draw_progress(box, task)
        row = box.row(align=True)
        if task.paused:
            row.operator("frog.resume_training", icon="PLAY")
        else:
            row.operator("frog.pause_training", icon="PAUSE")
        row.operator("frog.cancel_training", icon="CANCEL")
        return
    row = box.row()
    if task.error:
        wrapped_label(row.column(), task.error, icon="ERROR")
    elif task.is_cancelled:
        text = f"Cancelled at step {state.step:,}." if state.step else "Cancelled before the first step."
        row.label(text=text, icon="CANCEL")
    else:
        row.label(text=f"Finished in {duration(state.seconds)}.", icon="CHECKMARK")
    row.operator("frog.dismiss_training", text="", icon="X", emboss=False)


def _draw_result(box: bpy.types.UILayout, task: TrainingTask, result: Path, scene: bpy.types.Scene) -> None:
    """Draws what came of the training, what happened to it, and the next action."""
    if not task.is_cancelled and not task.error:
        wrapped_label(box, f"{result.name}: {task.state.sentence}")
    wrapped_label(box, task.note, icon="INFO")
    if not that_plays(scene, result):
        row = box.row()
        row.operator_context = "EXEC_DEFAULT"  # the file is known: no file browser
        text = "Import What There Is" if task.is_cancelled else "Import"
        row.operator("import_scene.frog", text=text, icon="IMPORT").filepath = str(result)
        return
    row = box.row(align=True)
    row.operator("frog.show_result", icon="HIDE_OFF").filepath = str(result)
    if not is_set_up(scene):
        row.operator("frog.set_up_scene", icon="SCENE_DATA")


def _draw_figures(layout: bpy.types.UILayout, state: TrainingState) -> None:
    column = layout.column(align=True)
    if state.loss is not None:
        column.label(text=f"Loss: {state.loss:.4f}")
    if state.psnr is not None:
        wrapped_label(column, f"PSNR: {state.psnr:.2f} dB ({state.psnr_split or 'training'} views)")
    if state.gaussians:
        is_partly_static = state.moving < state.gaussians and state.capacity
        dynamic = f" ({state.moving:,} dynamic)" if is_partly_static else ""
        column.label(text=f"Gaussians: {state.gaussians:,}{dynamic}")
