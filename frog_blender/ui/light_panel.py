"""The Objects panel of the FRoG tab: what the captures do to objects that other engines render."""

from __future__ import annotations

import bpy

from ..lighting import world
from ..lighting.proxy import is_for_shadows, proxies_of
from ..timeline import playback
from .capture_list import chosen_capture
from .sidebar_panel import SidebarPanel, split


class FROG_PT_light(SidebarPanel, bpy.types.Panel):
    """Light for the objects of this scene, and what their shadows fall on."""

    bl_label = "Light and Shadow"
    bl_parent_id = "FROG_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return playback.has_captures(context.scene)

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


register, unregister = bpy.utils.register_classes_factory((FROG_PT_light,))
