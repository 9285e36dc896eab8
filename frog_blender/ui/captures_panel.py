"""The Captures panel of the FRoG tab."""

from __future__ import annotations

from typing import Any

import bpy

from .. import capture_files, point_cloud
from ..nodes import ellipsoid_nodes
from ..relative_paths import library_of
from ..render.compositing import renders
from ..scene_import.scene_setup import is_set_up
from ..timeline import open_scenes, playback, playback_cache, retiming
from . import refreshing
from .text import wrapped_label


class FROG_PT_captures(bpy.types.Panel):
    """The captures of this scene and what they play."""

    bl_label = "Captures"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "FRoG"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.operator("import_scene.frog", icon="IMPORT")
        captures = list(playback.captures(context.scene.objects))
        if captures and not is_set_up(context.scene):
            layout.operator("frog.set_up_scene", icon="SCENE_DATA")
        if captures:
            layout.prop(context.scene.frog, "viewport_drawing")
        for obj in captures:
            box = layout.box()
            box.label(text=obj.name, icon="OUTLINER_OB_POINTCLOUD")
            box.prop(obj.frog, "filepath", text="")
            _draw_timing(box, obj.frog)
            problem = retiming.problem(obj, context.scene.frame_current_final)
            if problem:
                wrapped_label(box, problem, context, icon="ERROR")
            if outdated(obj):
                refreshing.soon()
            error = open_scenes.problem(playback.file_of(obj))
            if error:
                wrapped_label(box, error, context, icon="ERROR")
                if open_scenes.is_missing(playback.file_of(obj)) and library_of(obj) is None:
                    box.operator("frog.relink", icon="FILE_FOLDER").object_name = obj.name
            else:
                packed = capture_files.packed_bytes(obj) / playback_cache.MEGABYTE
                text = f", packed into the .blend ({packed:,.1f} MB)" if packed else ""
                box.label(text=f"{point_cloud.count(obj):,} Gaussians{text}")
                row = box.row()
                row.enabled = point_cloud.count(obj) <= ellipsoid_nodes.MOST
                row.prop(obj.frog, "display")
                box.prop(obj.frog, "density", slider=True)
                box.prop(obj.frog, "render_density", slider=True)
                _draw_bake(box, obj, context)
        _draw_lock(layout, context)
        row = layout.row(align=True)
        row.label(text=playback_cache.summary(), icon="MEMORY")
        row.operator("frog.clear_cache", text="", icon="TRASH")
        if context.object is not None and context.object.type == "CAMERA":
            layout.operator("frog.look_through", icon="VIEW_CAMERA")
        row = layout.row(align=True)
        row.operator("frog.add_clips", icon="FILE_MOVIE")
        row.operator("frog.hide_clips", text="", icon="HIDE_ON")
        layout.operator("frog.align_to_floor", icon="GRID")
        layout.operator_menu_enum("frog.compose", "engine", icon="NODE_COMPOSITING")
        for problem in renders.problems():
            wrapped_label(layout, problem, context, icon="ERROR")


def outdated(obj: bpy.types.Object) -> bool:
    """Whether a capture's files have changed since they were read. Linked captures are never read here."""
    if obj.data.library is not None or obj.data.override_library is not None:
        return False
    file = playback.file_of(obj)
    if open_scenes.is_outdated(file):
        return True
    is_played = not open_scenes.problem(file) and not retiming.problem(obj, 0.0)
    return is_played and open_scenes.is_bake_outdated(playback.bake_path(obj), file)


def _draw_lock(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Explains why points do not move in other engines' animations."""
    render = context.scene.render
    if render.engine == "FROG" or render.use_lock_interface or not any(playback.captures(context.scene.objects)):
        return
    wrapped_label(
        layout, "Captures do not move in animations of this engine unless Lock Interface is on.", context, icon="INFO"
    )
    layout.prop(render, "use_lock_interface")


def _draw_timing(layout: bpy.types.UILayout, settings: Any) -> None:
    layout.prop(settings, "use_remap")
    names = ("shown_frame",) if settings.use_remap else ("start_frame", "speed", "repeat")
    for name in names:
        layout.prop(settings, name)


def _draw_bake(layout: bpy.types.UILayout, obj: bpy.types.Object, context: bpy.types.Context) -> None:
    """Draws the state of a capture's bake and its buttons."""
    bake, problem = playback.baked(obj), playback.bake_problem(obj)
    if problem:
        wrapped_label(layout, problem, context, icon="ERROR")
    elif bake is not None:
        layout.label(
            text=f"Baked: {len(bake):,} frames, {bake.bytes / playback_cache.MEGABYTE:,.0f} MB", icon="CHECKMARK"
        )
    if obj.library is not None:
        return
    row = layout.row(align=True)
    row.operator("frog.bake", icon="FILE_CACHE").object_name = obj.name
    if problem or bake is not None:
        row.operator("frog.clear_bake", text="", icon="TRASH").object_name = obj.name
    column = layout.column()
    column.prop(obj.frog, "bake_folder")
    column.prop(obj.frog, "bake_megabytes")


_CLASSES = (FROG_PT_captures,)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
