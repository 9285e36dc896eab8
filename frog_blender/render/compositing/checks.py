"""What stands against an image that FRoG's is laid over, looked for before Blender begins to render it."""

from __future__ import annotations

from typing import Any

from ...cameras import engine_camera
from ...engine.errors import FrogError
from ...timeline import playback
from ...timeline.render_thread import in_main_thread
from ..collect_instances import check_placement
from . import compositor, scenes


def trouble(scene: Any) -> str:
    """Why a scene could not be rendered with its captures, in a sentence; empty if nothing stands against it."""
    try:
        _check_layers(scene)
        splats = scenes.laid_over(scene)
        if splats is not None:
            _check_settings(scene, splats)
            _check_captures(scene)
    except FrogError as error:
        return str(error)
    return ""


def _check_layers(scene: Any) -> None:
    for other in compositor.shown_scenes(scene):
        if other.frog.composed_with not in (None, scene, other):
            raise FrogError(foreign(scene, other))
    if scene.render.engine == "FROG" or scenes.laid_over(scene) is not None:
        return
    for obj in _rendered_captures(scene):
        if obj.frog.laid_over:
            raise FrogError(
                f"{obj.name} is left out of {scene.name}, as FRoG draws it in another scene of the same objects: "
                f"run Render With My Objects in {scene.name} as well."
            )


def foreign(scene: Any, splats: Any) -> str:
    return (
        f"The compositor of {scene.name} shows {splats.name}, which follows {splats.frog.composed_with.name}: run "
        f"Render With My Objects in {scene.name}."
    )


def _check_settings(scene: Any, splats: Any) -> None:
    if scene.render.engine == "FROG":
        raise FrogError(
            f"{scene.name} is rendered by FRoG, and {splats.name} is laid over it once more: choose another engine, or "
            "switch Compositing off."
        )
    if scene.render.use_single_layer:
        raise FrogError(f"{scene.name} renders a single layer, and so without {splats.name}: switch that off.")
    if splats not in compositor.rendered_scenes(scene):
        raise FrogError(f"Blender does not render {splats.name} from within a group of nodes: ungroup them.")
    cannot_follow = splats.library is not None or not in_main_thread()
    if cannot_follow and scenes.structural_changes(splats):
        raise FrogError(f"{splats.name} has other objects than {scene.name}: render again.")
    if scene.camera is not None:
        engine_camera(scene.camera, scene.camera.matrix_world, scene.render, 64, 64)
    world = scene.rigidbody_world
    if world is not None and world.enabled and world.collection is not None:
        for obj in world.collection.objects:
            if obj.rigid_body is not None and obj.rigid_body.type == "ACTIVE" and not obj.rigid_body.kinematic:
                raise FrogError(
                    f"{obj.name} is moved by a simulation, which {splats.name} does not have: bake it to keyframes "
                    "(Object > Rigid Body > Bake to Keyframes)."
                )


def _check_captures(scene: Any) -> None:
    for obj in _rendered_captures(scene):
        playback.open_scene(playback.file_of(obj))
        check_placement(obj.matrix_world, obj.name)


def _rendered_captures(scene: Any) -> list[Any]:
    """The captures that renders of a scene show, as far as its collections tell."""
    found: dict[Any, None] = {}
    to_look_at = [layer.layer_collection for layer in scenes.rendered_layers(scene)]
    for layer in to_look_at:  # grows
        if not layer.exclude and not layer.collection.hide_render:
            to_look_at.extend(layer.children)
            for obj in layer.collection.objects:
                if not obj.hide_render:
                    found[obj] = None
                    if obj.instance_type == "COLLECTION" and obj.instance_collection is not None:
                        inside = obj.instance_collection.all_objects
                        found |= dict.fromkeys(each for each in inside if not each.hide_render)
    return list(playback.captures(found))
