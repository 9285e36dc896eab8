"""The FRoG tab of the 3D viewport's sidebar, and the engine's few settings in the Properties editor."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from .. import background, carrier, ellipsoid_nodes, playback
from ..operators.train import can_resume
from . import capture_summary, preferences


class FROG_PT_train(bpy.types.Panel):
    """Capture folder in, trained scene out."""

    bl_label = "Train"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"

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
        layout.prop(settings, "import_when_done")

        needed = preferences.torch_needed()
        if needed:
            _sentence(layout, needed, context, icon="ERROR")
        row = layout.row()
        row.scale_y = 1.5
        row.enabled = not needed and not background.is_running()
        row.operator("frog.train", icon="PLAY")
        if can_resume(settings):
            row.operator("frog.train", text="Resume", icon="FRAME_NEXT").resume = True
        if background.current is not None:
            _draw_training(layout, background.current.state, context)


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


class FROG_PT_captures(bpy.types.Panel):
    """The captures of this scene and what they play."""

    bl_label = "Captures"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.operator("import_scene.frog", icon="IMPORT")
        for obj in playback.captures(context.scene.objects):
            box = layout.box()
            box.label(text=obj.name, icon="OUTLINER_OB_POINTCLOUD")
            box.prop(obj.frog, "filepath", text="")
            _draw_timing(box, obj.frog)
            error = playback.problem(playback.file_of(obj))
            if error:
                _sentence(box, error, context, icon="ERROR")
            else:
                box.label(text=f"{carrier.count(obj):,} Gaussians")
                row = box.row()
                row.enabled = carrier.count(obj) <= ellipsoid_nodes.MOST
                row.prop(obj.frog, "display")
        if context.object is not None and context.object.type == "CAMERA":
            layout.operator("frog.look_through", icon="VIEW_CAMERA")
        layout.operator_menu_enum("frog.compose", "engine", icon="NODE_COMPOSITING")


class FROG_PT_film(bpy.types.Panel):
    """What lies behind and before the FROG engine's splats."""

    bl_label = "Film"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {"FROG"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context: Any) -> None:
        self.layout.use_property_split = True
        self.layout.prop(context.scene.render, "film_transparent", text="Transparent")
        self.layout.prop(context.scene.frog, "hold_out")


class FROG_PT_passes(bpy.types.Panel):
    """Passes that the FROG engine can write."""

    bl_label = "Passes"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "view_layer"
    COMPAT_ENGINES = {"FROG"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context: Any) -> None:
        self.layout.use_property_split = True
        self.layout.prop(context.view_layer, "use_pass_z", text="Depth")
        self.layout.prop(context.view_layer, "use_pass_vector", text="Vector")


def _draw_timing(layout: Any, settings: Any) -> None:
    layout.prop(settings, "use_remap")
    names = ("shown_frame",) if settings.use_remap else ("start_frame", "speed", "repeat")
    for name in names:
        layout.prop(settings, name)


def _draw_capture(layout: Any, folder: str, context: Any) -> None:
    summary = capture_summary.known(folder)
    if summary is None:  # a file that was just opened: looking takes time, so the user says when
        layout.operator("frog.inspect_capture", icon="VIEWZOOM")
        return
    box = layout.box()
    column = box.column(align=True)
    for line in summary.lines:
        column.label(text=line)
    for warning in summary.warnings:
        _sentence(box, warning, context, icon="INFO")
    if summary.error:
        _sentence(box, summary.error, context, icon="ERROR")
        box.operator("frog.inspect_capture", text="Check Again", icon="FILE_REFRESH")


def _draw_training(layout: Any, state: background.TrainingState, context: Any) -> None:
    box = layout.box()
    if state.running:
        if state.stage:
            box.progress(factor=state.fraction, text=state.stage)
        else:
            box.progress(factor=state.fraction, text=f"Step {state.step:,} of {state.steps:,}")
    elif state.error:
        _sentence(box, state.error, context, icon="ERROR")
    elif state.cancelled:
        box.label(text=f"Cancelled at step {state.step:,}.", icon="CANCEL")
    else:
        box.label(text=f"Finished in {_duration(state.seconds)}.", icon="CHECKMARK")
    column = box.column(align=True)
    if state.running and not state.stage and state.step:
        column.label(text=f"Time left: {_duration(state.seconds_left)}")
    if state.loss is not None:
        column.label(text=f"Loss: {state.loss:.4f}")
    if state.psnr is not None:
        column.label(text=f"PSNR: {state.psnr:.2f} dB ({state.psnr_split or 'training'} views)")
    if state.gaussians:
        still = state.gaussians - state.moving
        resting = f" ({state.moving:,} move)" if still and state.capacity else ""
        column.label(text=f"Gaussians: {state.gaussians:,}{resting}")
    for line in state.capacity:
        _sentence(box, line, context, icon="MOD_DECIM")
    for warning in state.warnings[-3:]:
        _sentence(box, warning, context, icon="INFO")
    if state.running:
        box.operator("frog.cancel_training", icon="CANCEL")


def _duration(seconds: float) -> str:
    """3725 -> "1 h 2 min", 95 -> "1 min 35 s", 8 -> "8 s"."""
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _sentence(layout: Any, text: str, context: Any, icon: str) -> None:
    """A label over as many lines as the sidebar's width asks for; Blender does not wrap by itself."""
    scale = context.preferences.system.ui_scale
    width = max(int(context.region.width / (7.0 * scale)) - 6, 16) if context.region else 40
    column = layout.column(align=True)
    column.scale_y = 0.8
    for i, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if i == 0 else "BLANK1")


_CLASSES = (FROG_PT_train, FROG_PT_train_advanced, FROG_PT_captures, FROG_PT_film, FROG_PT_passes)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
