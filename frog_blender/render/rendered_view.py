"""The camera that a render looks through, and the settings in effect."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from ..cameras import distance_added, engine_camera
from ..engine.errors import FrogError
from .compositing import renders
from .region import rendered_part

if TYPE_CHECKING:
    from ..engine.capture.camera import Camera
    from ..engine.native.options import RasterizeOptions


def options_of(depsgraph: bpy.types.Depsgraph, eye: bpy.types.Object, width: int, height: int) -> RasterizeOptions:
    """Options for the Render Region, with the near plane at Blender's camera even if the engine's is further back."""
    from ..engine.native.options import RasterizeOptions

    region = rendered_part(renders.leading(depsgraph.scene.original).render, width, height)
    return RasterizeOptions(region=region, near_plane=RasterizeOptions.near_plane + distance_added(eye.data))


def settings_of(depsgraph: bpy.types.Depsgraph) -> bpy.types.RenderSettings:
    """The render settings in effect."""
    return settings_scene(depsgraph).render


def settings_scene(depsgraph: bpy.types.Depsgraph) -> bpy.types.Scene:
    """The scene whose render settings are in effect: the followed one while that is rendered."""
    scene = depsgraph.scene
    first = renders.leading(scene.original)
    return first if scene.original.frog.composed_with == first else scene


def eye_of(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object:
    """The evaluated active camera: of the scene, of a sequencer strip or of a stereo eye; while the followed scene
    is rendered, the camera of that scene.
    """
    scene = depsgraph.scene.original
    camera = engine.camera_override or scene.camera
    first = renders.leading(scene)
    if scene.frog.composed_with == first != scene and first.camera != scene.camera:
        camera = first.camera
    if camera is None:
        raise FrogError(f"Scene {scene.name}: found no active camera, expected one to render through.")
    evaluated = camera.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise FrogError(f"{camera.name} is not in any collection that {scene.name} renders.")
    return evaluated


def camera_of(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, eye: bpy.types.Object) -> Camera:
    """The engine camera of the rendered view; FrogError for a panoramic one, which is none."""
    render, width, height = settings_of(depsgraph), engine.resolution_x, engine.resolution_y
    shift = engine.camera_shift_x(eye) if render.use_multiview else None
    return engine_camera(eye, place_of(engine, depsgraph, eye), render, width, height, shift_x=shift)


def is_panoramic(eye: bpy.types.Object) -> bool:
    """Whether a camera has no plane that it projects to."""
    return eye.type == "CAMERA" and eye.data.type == "PANO"


def place_of(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, eye: bpy.types.Object) -> Any:
    """The matrix that places the eye: in stereo, that of the rendered view."""
    return engine.camera_model_matrix(eye) if settings_of(depsgraph).use_multiview else eye.matrix_world
