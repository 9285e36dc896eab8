"""The Render panel of the FRoG tab: who draws the captures, with which colors, and among what."""

from __future__ import annotations

import bpy

from ..render.compositing import renders
from ..scene_import.scene_setup import are_colors_unchanged, is_set_up
from ..timeline import playback
from .sidebar_panel import SidebarPanel, split
from .text import wrapped_label

_LARGER = 1.25  # times the filmed size, from which on a render is larger than what was trained


class FROG_PT_render(SidebarPanel, bpy.types.Panel):
    """What a render of this scene shows of its captures."""

    bl_label = "Render"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return playback.has_captures(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = split(self.layout), context.scene
        if not is_set_up(scene):
            layout.operator("frog.set_up_scene", icon="SCENE_DATA")
        layout.prop(scene.render, "engine")
        draw_with_objects(layout)
        draw_colors(layout, context)
        layout.operator("frog.render_film", icon="FILE_MOVIE")
        _draw_size(layout, context)
        _draw_lock(layout, context)
        for problem in renders.problems():
            wrapped_label(layout, problem, context, icon="ERROR")


def draw_with_objects(layout: bpy.types.UILayout) -> None:
    """Draws the choice of an engine for the other objects, grey where it is of no use."""
    row = layout.row()
    row.enabled = bpy.ops.frog.compose.poll()
    row.operator_menu_enum("frog.compose", "engine", icon="NODE_COMPOSITING")


def draw_colors(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draws what the scene's color management does to the colors of the videos, and a way out."""
    if are_colors_unchanged(context.scene):
        return
    settings = context.scene.view_settings
    name = settings.view_transform if settings.look == "None" else f"{settings.view_transform}, {settings.look}"
    wrapped_label(layout, f"{name} changes the colors of the videos.", context, icon="COLOR")
    layout.operator("frog.show_as_filmed", icon="LOOP_BACK")


def _draw_size(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Tells where renders are larger than what was filmed."""
    render, camera = context.scene.render, context.scene.camera
    filmed = tuple(camera.data.frog.size) if camera is not None and camera.type == "CAMERA" else (0, 0)
    wide = render.resolution_x * render.resolution_percentage / 100
    if filmed[0] and wide > _LARGER * filmed[0]:
        sentence = f"The camera filmed {filmed[0]} x {filmed[1]} pixels: larger renders show no more detail."
        wrapped_label(layout, sentence, context, icon="INFO")


def _draw_lock(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Explains why points do not move in other engines' animations."""
    render = context.scene.render
    if render.engine == "FROG" or render.use_lock_interface:
        return
    wrapped_label(
        layout, "Captures do not move in animations of this engine unless Lock Interface is on.", context, icon="INFO"
    )
    layout.prop(render, "use_lock_interface")


register, unregister = bpy.utils.register_classes_factory((FROG_PT_render,))
