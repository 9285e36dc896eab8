"""Panels of the FROG engine in the Properties editor."""

from __future__ import annotations

import bpy


class _EnginePanel:
    """Base of panels that are shown while FROG is the render engine."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    COMPAT_ENGINES = {"FROG"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES


class FROG_PT_film(_EnginePanel, bpy.types.Panel):
    """Film transparency and holdout."""

    bl_label = "Film"
    bl_context = "render"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(context.scene.render, "film_transparent", text="Transparent")
        self.layout.prop(context.scene.frog, "hold_out")


class FROG_PT_passes(_EnginePanel, bpy.types.Panel):
    """Passes that the FROG engine can write."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(context.view_layer, "use_pass_z", text="Depth")
        self.layout.prop(context.view_layer, "use_pass_vector", text="Vector")
        self.layout.prop(context.view_layer, "use_pass_object_index", text="Object Index")


_CLASSES = (FROG_PT_film, FROG_PT_passes)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
