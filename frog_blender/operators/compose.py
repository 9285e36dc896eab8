"""Captures among the user's own objects: two scenes of the same objects, one for each engine, put together by F12.

The user's scene is rendered by Cycles or EEVEE. A second one, linked to the same collections, is rendered by FROG on a
transparent film, with splats that end where an object hides them (see holdout.py). The compositor lays it over the
first; Blender renders both when the first is rendered.
"""

# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import EnumProperty

from ..render.compositing import compositor, scenes
from ..timeline import playback


class FROG_OT_compose(bpy.types.Operator):
    """Render your own objects with Cycles or EEVEE and the captures with FRoG, each hiding what is behind it, in one
    image. It follows what you change afterwards: camera, frames, region and size, collections and objects"""

    bl_idname = "frog.compose"
    bl_label = "Render With My Objects"
    bl_options = {"REGISTER", "UNDO"}

    engine: EnumProperty(
        name="Objects",
        description="What renders the objects that are no captures",
        items=(
            ("CYCLES", "Cycles", "Path tracing: soft light and shadows, slow"),
            ("EEVEE", "EEVEE", "Rasterization: fast, needs a graphics card"),
        ),
        default="CYCLES",
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        is_splats = _is_splats(context.scene)
        asked = "Use it in the scene of your objects." if is_splats else "Import a capture first."
        if is_splats and context.scene.frog.composed_with is None:
            asked = "Turn Objects Hide Splats off first."
        cls.poll_message_set(asked)
        return not is_splats and next(playback.captures(context.scene.objects), None) is not None

    def execute(self, context: Any) -> set[str]:
        scene = context.scene
        if scene.render.engine != (engine := _engine_name(self.engine)):
            scene.render.engine = engine
        splats = scenes.laid_over(scene)
        if splats is None:
            splats = _splat_scene(scene)
            compositor.lay_over(scene, splats)
        splats.frog.composed_with, splats.frog.hold_out = scene, True
        scenes.begin()
        self.report({"INFO"}, f"F12 in {scene.name} now renders {splats.name} as well and puts them together.")
        return {"FINISHED"}


def _engine_name(engine: str) -> str:
    """EEVEE had another name from 4.2 to 4.5."""
    if engine != "EEVEE":
        return engine
    known = bpy.types.RenderSettings.bl_rna.properties["engine"].enum_items.keys()
    return next((name for name in ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE") if name in known), "BLENDER_EEVEE")


def _is_splats(scene: Any) -> bool:
    """Whether a scene is itself one of captures among objects."""
    return scene.frog.composed_with is not None or (scene.frog.hold_out and scene.render.engine == "FROG")


def _splat_scene(scene: Any) -> Any:
    """The scene of the captures: the one that the compositor shows already, or a known or a new one."""
    name = f"{scene.name} FRoG"
    nodes = getattr(compositor.tree_of(scene), "nodes", ())
    read = [node.scene for node in nodes if node.type == "R_LAYERS" and node.scene is not None]
    followers = [found for found in scenes.followers() if found.frog.composed_with == scene]
    of_before = [found for found in (*read, bpy.data.scenes.get(name)) if found is not None and _is_nobodys(found)]
    return next(iter((*followers, *of_before)), None) or bpy.data.scenes.new(name)


def _is_nobodys(scene: Any) -> bool:
    """Whether a scene is of captures, and of a .blend in which such scenes did not tell whom they follow yet."""
    return _is_splats(scene) and scene.frog.composed_with is None


register, unregister = bpy.utils.register_classes_factory((FROG_OT_compose,))
