"""Checks whether a composed image can be rendered, before Blender begins to render it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...engine.errors import FrogError
from ...timeline import playback
from ...timeline.render_thread import in_main_thread
from ..collect_instances import check_placement
from ..panoramic_camera import check_lens
from . import compositor, scenes

if TYPE_CHECKING:
    import bpy


def trouble(scene: bpy.types.Scene) -> str:
    """Why a scene cannot be rendered with its captures, in a sentence; empty if it can."""
    try:
        _check_layers(scene)
        splats = scenes.overlay_of(scene)
        if splats is not None:
            _check_settings(scene, splats)
            _check_captures(scene)
    except FrogError as error:
        return str(error)
    return ""


def _check_layers(scene: bpy.types.Scene) -> None:
    for other in compositor.shown_scenes(scene):
        if other.frog.composed_with not in (None, scene, other):
            raise FrogError(foreign(scene, other))
    if scene.render.engine == "FROG" or scenes.overlay_of(scene) is not None:
        return
    for obj in _rendered_captures(scene):
        if obj.frog.laid_over:
            raise FrogError(
                f"{obj.name} is not rendered in {scene.name}, because FRoG renders it in another scene of the same "
                f"objects. Run Render With My Objects in {scene.name} as well."
            )


def foreign(scene: bpy.types.Scene, splats: bpy.types.Scene) -> str:
    return (
        f"The compositor of {scene.name} shows {splats.name}, which follows {splats.frog.composed_with.name}. Run "
        f"Render With My Objects in {scene.name}."
    )


def _check_settings(scene: bpy.types.Scene, splats: bpy.types.Scene) -> None:
    if scene.render.engine == "FROG":
        raise FrogError(
            f"{scene.name} is rendered by FRoG, and {splats.name} is overlaid on it once more. Choose another engine "
            "or disable Compositing."
        )
    if scene.render.use_single_layer:
        raise FrogError(f"{scene.name} renders a single layer, without {splats.name}. Disable Render Single Layer.")
    if splats not in compositor.rendered_scenes(scene):
        raise FrogError(f"Blender does not render {splats.name} from within a node group. Ungroup its nodes.")
    cannot_follow = splats.library is not None or not in_main_thread()
    if cannot_follow and scenes.structural_changes(splats):
        raise FrogError(f"{splats.name} does not have the same objects as {scene.name}. Render again.")
    if scene.camera is not None:
        check_lens(scene.camera, scene.render)
    world = scene.rigidbody_world
    if world is not None and world.enabled and world.collection is not None:
        for obj in world.collection.objects:
            if obj.rigid_body is not None and obj.rigid_body.type == "ACTIVE" and not obj.rigid_body.kinematic:
                raise FrogError(
                    f"{obj.name} is moved by a simulation, which {splats.name} does not have. Bake it to keyframes "
                    "(Object > Rigid Body > Bake to Keyframes)."
                )


def _check_captures(scene: bpy.types.Scene) -> None:
    for obj in _rendered_captures(scene):
        playback.open_scene(playback.file_of(obj))
        if any(map(any, obj.matrix_world.to_3x3())):  # scaled to nothing, it is not drawn
            check_placement(obj.matrix_world, obj.name)


def _rendered_captures(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The captures that renders of a scene show, as far as its collections tell."""
    found: dict[bpy.types.Object, None] = {}
    to_look_at = [layer.layer_collection for layer in scenes.rendered_layers(scene)]
    for layer in to_look_at:  # grows
        if not layer.exclude and not layer.collection.hide_render:
            to_look_at.extend(layer.children)
            for obj in layer.collection.objects:
                if not obj.hide_render:
                    found[obj] = None
                    if obj.instance_type == "COLLECTION" and obj.instance_collection is not None:
                        inside = obj.instance_collection.all_objects
                        found |= dict.fromkeys(shown for shown in inside if not shown.hide_render)
    return list(playback.captures(found))
