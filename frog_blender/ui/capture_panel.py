"""The Capture panel of the FRoG tab: what is trained from, and what was found in it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy

from . import calibration_panel, capture_reading, capture_summary, refreshing
from .sidebar_panel import SidebarPanel, split
from .text import wrapped_label


class FROG_PT_capture(SidebarPanel, bpy.types.Panel):
    """The folder of a capture, what is in it, and what it lacks."""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        layout = split(self.layout)
        settings = context.scene.frog
        layout.prop(settings, "capture_folder", text="")
        if not settings.capture_folder:
            wrapped_label(layout, "Choose a folder with videos or images, or drop videos into the viewport.", context)
            return
        _draw_capture(layout, bpy.path.abspath(settings.capture_folder), context)


class FROG_PT_masks(SidebarPanel, bpy.types.Panel):
    """Which parts of the images are trained on."""

    bl_label = "Masks"
    bl_parent_id = "FROG_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.frog.capture_folder)

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = split(self.layout), context.scene.frog
        layout.prop(settings, "masks")
        if settings.masks == "key":
            row = layout.row(align=True)
            row.prop(settings, "key_color")
            row.prop(settings, "key_tolerance", text="")


def _draw_capture(layout: bpy.types.UILayout, folder: str, context: bpy.types.Context) -> None:
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
        wrapped_label(column, line, context)
    for warning in summary.warnings:
        wrapped_label(box, warning, context, icon="INFO")
    calibration_panel.draw_calibration(box, Path(folder), summary, context)
    if summary.error:
        wrapped_label(box, summary.error, context, icon="ERROR")
        box.operator("frog.inspect_capture", text="Check Again", icon="FILE_REFRESH")


_CLASSES = (FROG_PT_capture, FROG_PT_masks)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
