"""The Render panel of the FRoG tab: who draws the captures, with which colours, and what they do to other objects."""

import bpy

from ..lighting import world
from ..lighting.proxy import is_for_shadows, proxies_of
from ..render.compositing import renders
from ..scene_import.scene_setup import are_colors_unchanged, is_set_up
from ..viewport import hiding
from .captures_panel import OfCaptures, chosen_capture
from .sidebar_panel import SidebarPanel, SubPanel, draw_reason, split, wrapped_label


class FROG_PT_render(OfCaptures, SidebarPanel, bpy.types.Panel):
    """What a render of this scene shows of its captures."""

    bl_label = "Render"

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = split(self.layout), context.scene
        if not is_set_up(scene):
            layout.operator("frog.set_up_scene", icon="SCENE_DATA")
        layout.prop(scene.render, "engine")
        wrapped_label(layout, hiding.undrawn(context), icon="INFO")
        draw_with_objects(layout)
        draw_colors(layout, context)
        layout.operator("frog.render_film", icon="FILE_MOVIE")
        wrapped_label(layout, renders.film(), icon="CHECKMARK")
        _draw_lock(layout, context)
        for problem in renders.problems():
            wrapped_label(layout, problem, icon="ERROR")


def draw_with_objects(layout: bpy.types.UILayout) -> None:
    """Draws the choice of an engine for the other objects, grey with a reason where it is of no use."""
    row = layout.row()
    row.enabled = bpy.ops.frog.compose.poll()
    row.operator_menu_enum("frog.compose", "engine", icon="NODE_COMPOSITING")
    draw_reason(layout, "FROG_OT_compose")


def draw_colors(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draws what the scene's colour management does to the colours of the videos, and a way out."""
    if are_colors_unchanged(context.scene):
        return
    settings = context.scene.view_settings
    name = settings.view_transform if settings.look == "None" else f"{settings.view_transform}, {settings.look}"
    wrapped_label(layout, f"{name} changes the colours of the videos.", icon="COLOR")
    layout.operator("frog.show_as_filmed", icon="LOOP_BACK")


def _draw_lock(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Explains why points do not move in other engines' animations."""
    render = context.scene.render
    if render.engine == "FROG" or render.use_lock_interface:
        return
    wrapped_label(layout, "Captures do not move in animations of this engine unless Lock Interface is on.", icon="INFO")
    layout.prop(render, "use_lock_interface")


class FROG_PT_light(OfCaptures, SubPanel, bpy.types.Panel):
    """Light for the objects of this scene, and what their shadows fall on."""

    bl_label = "Light and Shadow"
    bl_parent_id = "FROG_PT_render"

    def draw(self, context: bpy.types.Context) -> None:
        layout = split(self.layout)
        lit = world.lit_scene(context.scene)
        light = world.light_node(lit.world) if lit.world is not None else None
        if light is not None:
            row = layout.row(align=True)
            row.operator("frog.light_objects", text="Update Light", icon="FILE_REFRESH")
            row.operator("frog.use_own_world", icon="LOOP_BACK")
            layout.prop(light.inputs["Strength"], "default_value", text="Strength")
        else:
            layout.operator("frog.light_objects", icon="WORLD")
        layout.operator("frog.make_proxy", icon="MESH_DATA")
        chosen = chosen_capture(context)
        for obj in proxies_of(chosen) if chosen is not None else ():
            box = layout.box()
            box.label(text=obj.name, icon="OUTLINER_OB_MESH")
            row = box.row(align=True, heading="Shadows")
            if is_for_shadows(obj):
                row.prop(obj, "is_shadow_catcher", text="Catch", toggle=True)
            row.prop(obj, "visible_shadow", text="Cast", toggle=True)
