"""The panel Captures of the FRoG tab: what this scene plays, and when."""

from __future__ import annotations

from typing import Any

import bpy

from .. import carrier, ellipsoid_nodes, playback
from .text import sentence


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
                sentence(box, error, context, icon="ERROR")
            else:
                box.label(text=f"{carrier.count(obj):,} Gaussians")
                row = box.row()
                row.enabled = carrier.count(obj) <= ellipsoid_nodes.MOST
                row.prop(obj.frog, "display")
        if context.object is not None and context.object.type == "CAMERA":
            layout.operator("frog.look_through", icon="VIEW_CAMERA")
        row = layout.row(align=True)
        row.operator("frog.add_clips", icon="FILE_MOVIE")
        row.operator("frog.hide_clips", text="", icon="HIDE_ON")
        layout.operator("frog.align_to_floor", icon="GRID")
        layout.operator_menu_enum("frog.compose", "engine", icon="NODE_COMPOSITING")


def _draw_timing(layout: Any, settings: Any) -> None:
    layout.prop(settings, "use_remap")
    names = ("shown_frame",) if settings.use_remap else ("start_frame", "speed", "repeat")
    for name in names:
        layout.prop(settings, name)


_CLASSES = (FROG_PT_captures,)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
