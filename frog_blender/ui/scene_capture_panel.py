"""The sub-panel that makes a capture of the open scene."""

from __future__ import annotations

import bpy

from ..scene_capture import placing
from ..tasks.scene_capture import SceneCaptureTask
from .sidebar_panel import SidebarPanel, split
from .text import duration, wrapped_label


class FROG_PT_scene_capture(SidebarPanel, bpy.types.Panel):
    """A rig of cameras around a box, and what is rendered through it."""

    bl_label = "From This Scene"
    bl_parent_id = "FROG_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = split(self.layout), context.scene.frog.rig
        cameras = placing.cameras_of(settings)
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
        if cameras:
            _draw_rendering(layout, context, len(cameras))


def _draw_rendering(layout: bpy.types.UILayout, context: bpy.types.Context, cameras: int) -> None:
    scene, settings, task = context.scene, context.scene.frog.rig, SceneCaptureTask.current()
    if task is not None and task.is_running:
        _draw_progress(layout, task)
        return
    layout.prop(settings, "size")
    layout.prop(settings, "folder")
    frames = len(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    sentence = f"{cameras * frames:,} images: {frames:,} frames of {cameras:,} cameras"
    wrapped_label(layout, sentence, context, icon="RENDER_STILL")
    row = layout.row()
    row.scale_y = 1.5
    row.operator("frog.capture_scene", icon="RENDER_ANIMATION")
    if task is not None:
        _draw_end(layout, context, task)


def _draw_progress(layout: bpy.types.UILayout, task: SceneCaptureTask) -> None:
    left = task.seconds_left
    doing = _images(task)
    if task.is_stopping:
        doing = "Cancelling"
    elif left is not None:
        doing += f", {duration(left)} left"
    layout.progress(factor=task.progress.fraction, text=doing)
    layout.operator("frog.cancel_scene_capture", icon="CANCEL")


def _draw_end(layout: bpy.types.UILayout, context: bpy.types.Context, task: SceneCaptureTask) -> None:
    if task.error:
        wrapped_label(layout, task.error, context, icon="ERROR")
    elif task.is_cancelled:
        sentence = f"Cancelled at {_images(task)}. Render Capture continues there."
        wrapped_label(layout, sentence, context, icon="CANCEL")
    else:
        sentence = f"{task.progress.total:,} images are in {task.request.folder.name}. Train FRoG learns from them."
        wrapped_label(layout, sentence, context, icon="CHECKMARK")


def _images(task: SceneCaptureTask) -> str:
    return f"{task.progress.done:,} of {task.progress.total:,} images"


register, unregister = bpy.utils.register_classes_factory((FROG_PT_scene_capture,))
