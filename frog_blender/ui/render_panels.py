"""The FROG engine's few settings in the Properties editor."""

from __future__ import annotations

from typing import Any

import bpy


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
        self.layout.prop(context.view_layer, "use_pass_object_index", text="Object Index")


_CLASSES = (FROG_PT_film, FROG_PT_passes)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
