"""Render With My Objects: two scenes of the same objects, one for each engine, combined by the compositor.

The user's scene is rendered by Cycles or EEVEE. A second one, linked to the same collections, is rendered by FROG on a
transparent film, with splats that end where an object hides them (see holdout.py). The compositor lays it over the
first; Blender renders both when the first is rendered.
"""

# mypy: disable-error-code="valid-type"

import bpy

from ..engine.errors import FrogError
from ..lighting import world
from ..lighting.world import light_by
from ..properties import choice, switch
from ..render.compositing import compositor, scenes
from ..scene_import.capture_objects import active_capture
from ..scene_import.scene_setup import has_world_of_its_own
from ..timeline import playback
from .bases import UndoableOperator


class FROG_OT_compose(UndoableOperator, bpy.types.Operator):
    """Render your objects with Cycles or EEVEE and the captures with FRoG into one image, with correct occlusion. \
Later changes of camera, frame range, render region, resolution, collections and objects are followed"""

    bl_label = "Render With My Objects"

    engine: choice(
        "Objects",
        "Render engine for all objects that are not captures",
        (
            ("CYCLES", "Cycles", "Path tracing: soft light and shadows, slow"),
            ("EEVEE", "EEVEE", "Rasterization: fast, needs a graphics card"),
        ),
    )
    light: switch(
        "Light by Capture",
        "Light the objects with what the capture shows at the current frame, unless the scene has a world "
        "that you made. Cameras see the world as before",
        True,
    )

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        if context.scene.frog.composed_with is not None:
            return "Use this in the scene of your objects."
        if context.scene.frog.hold_out and context.scene.render.engine == "FROG":  # a scene of captures itself
            return "Disable Objects Hide Splats first."
        return "" if playback.has_captures(context.scene) else "Import a capture first."

    def act(self, context: bpy.types.Context) -> str:
        scene = context.scene
        scene.render.engine = _engine_name(self.engine)
        splats = scenes.overlay_of(scene)
        if splats is None:
            splats = _splat_scene(scene)
            compositor.overlay_scene(scene, splats)
        splats.frog.composed_with, splats.frog.hold_out = scene, True
        scenes.begin()
        if self.light and not has_world_of_its_own(scene) and not world.is_lit(scene):
            self._light(context)
        return f"F12 in {scene.name} now also renders {splats.name} and overlays it."

    def _light(self, context: bpy.types.Context) -> None:
        """Without it, the objects would stand in the dark of a grey or black world among what was filmed in light."""
        try:
            light_by(active_capture(context) or playback.captures_in(context.scene)[0], context)
        except FrogError as error:
            self.report({"WARNING"}, f"The capture does not light your objects: {error}")


def _engine_name(engine: str) -> str:
    """The identifier of an engine; EEVEE had another one from 4.2 to 4.5."""
    if engine != "EEVEE":
        return engine
    known = bpy.types.RenderSettings.bl_rna.properties["engine"].enum_items.keys()
    return "BLENDER_EEVEE_NEXT" if "BLENDER_EEVEE_NEXT" in known else "BLENDER_EEVEE"


def _splat_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    """The captures' scene that follows a scene already, or a new one."""
    followers = (follower for follower in scenes.followers() if follower.frog.composed_with == scene)
    return next(followers, None) or bpy.data.scenes.new(f"{scene.name} FRoG")
