"""Panels of the FROG engine in the Properties editor."""

import bpy

from ..render import blur
from ..render.world import background_node
from .captures_panel import OfCaptures
from .render_panel import draw_colors, draw_with_objects
from .sidebar_panel import wrapped_label


class _RenderPanel:
    """Base of panels in the properties editor."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"


class _EnginePanel(_RenderPanel):
    """Base of those that are shown while FROG is the render engine."""

    COMPAT_ENGINES = {"FROG"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES


class FROG_PT_with_objects(OfCaptures, _RenderPanel, bpy.types.Panel):
    """Captures among the objects of another engine's scene, where renders are set up."""

    bl_label = "FRoG Captures"

    def draw(self, context: bpy.types.Context) -> None:
        draw_with_objects(self.layout)
        draw_colors(self.layout, context)


class FROG_PT_film(_EnginePanel, bpy.types.Panel):
    """Film transparency and holdout."""

    bl_label = "Film"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(context.scene.render, "film_transparent", text="Transparent")
        row = self.layout.row()
        row.use_property_split = False  # its name is longer than half of the panel
        row.prop(context.scene.frog, "hold_out")


class FROG_PT_depth_of_field(_EnginePanel, bpy.types.Panel):
    """Depth of field: the settings of the scene's camera, and what they cost."""

    bl_label = "Depth of Field"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        camera = context.scene.camera if super().poll(context) else None
        return camera is not None and camera.type == "CAMERA" and camera.data.type != "PANO"

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.camera.data.dof, "use_dof", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        dof = scene.camera.data.dof
        layout.use_property_split = True
        layout.active = dof.use_dof
        layout.prop(dof, "focus_object")
        if dof.focus_object is None:
            layout.prop(dof, "focus_distance")
        layout.prop(dof, "aperture_fstop")
        layout.prop(scene.frog, "lens_samples")
        _draw_cost(layout, scene)
        wrapped_label(layout, "Viewports show everything sharp.", icon="INFO")


class FROG_PT_motion_blur(_EnginePanel, bpy.types.Panel):
    """Motion blur: Blender's own settings, whose panels belong to its engines."""

    bl_label = "Motion Blur"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        layout.use_property_split = True
        layout.active = scene.render.use_motion_blur
        layout.prop(scene.render, "motion_blur_position", text="Position")
        layout.prop(scene.render, "motion_blur_shutter")
        layout.prop(scene.frog, "motion_samples")
        _draw_cost(layout, scene)


def _draw_cost(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Tells what blurs cost, which share their samples."""
    count = blur.sample_count(scene, blur.has_lens(scene.camera))
    if count > 1:
        wrapped_label(layout, f"Each image takes as long as {count:,} without blur.", icon="TIME")


class FROG_PT_background(_EnginePanel, bpy.types.Panel):
    """The colour behind the splats, which is the world's."""

    bl_label = "Background"
    bl_context = "world"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.scene is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, world = self.layout, context.scene.world
        layout.use_property_split = True
        if context.scene.render.film_transparent:
            wrapped_label(layout, "Not drawn: Render > Film > Transparent is on.", icon="INFO")
        if world is None:
            wrapped_label(layout, "Without a world, the background is the capture's own.", icon="INFO")
            return
        node = background_node(world)
        if node is None:
            layout.prop(world, "color")
            return
        layout.prop(node.inputs["Color"], "default_value", text="Colour")
        layout.prop(node.inputs["Strength"], "default_value", text="Strength")


class FROG_PT_passes(_EnginePanel, bpy.types.Panel):
    """Passes that the FROG engine can write."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(context.view_layer, "use_pass_z", text="Depth")
        self.layout.prop(context.view_layer, "use_pass_vector", text="Vector")
        self.layout.prop(context.view_layer, "use_pass_object_index", text="Object Index")
