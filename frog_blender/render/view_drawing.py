"""Drawing Gaussians through the rendered camera: as one image, or a panorama of several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..cameras import view_matrix_of
from .holdout import draw_before, limits_of_objects
from .panoramic_camera import rays_of
from .rendered_view import camera_of, eye_of, is_panoramic, options_of, place_of, settings_of

if TYPE_CHECKING:
    from ..engine.capture.camera import Camera
    from ..engine.gaussians import GaussianArrays
    from ..engine.native.options import RasterizeOptions
    from ..engine.playback.render import Drawing


@dataclass(frozen=True)
class Drawer:
    """How a view is drawn.

    Attributes:
        draw: draws Gaussians in the Render Region.
        size: its width and height.
        blind: (H, W) where the lens sees nothing at all, not even the background; None for nowhere.
    """

    draw: Callable[[GaussianArrays], Drawing]
    size: tuple[int, int]
    blind: np.ndarray | None = None


Through = Callable[["Camera"], "Camera"]
"""Moves a camera to a point of its lens."""


def drawer_of(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, through: Through | None = None) -> Drawer:
    """How the rendered view is drawn; FrogError for a camera that cannot be."""
    eye, (width, height) = eye_of(engine, depsgraph), (engine.resolution_x, engine.resolution_y)
    options = options_of(depsgraph, eye, width, height)
    if is_panoramic(eye):
        return _panorama(engine, depsgraph, eye, options)
    camera = camera_of(engine, depsgraph, eye)
    size = options.region_of(camera)[2:]
    return Drawer(partial(_before_objects, depsgraph, through(camera) if through else camera, options), size)


def _before_objects(
    depsgraph: bpy.types.Depsgraph, camera: Camera, options: RasterizeOptions, gaussians: GaussianArrays
) -> Drawing:
    limits = limits_of_objects(depsgraph, camera, options) if depsgraph.scene.frog.hold_out else None
    return draw_before(limits, gaussians, camera, options)


def _panorama(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, eye: bpy.types.Object, options: RasterizeOptions
) -> Drawer:
    from ..engine.native.options import RasterizeOptions
    from ..engine.playback.panorama import draw_panorama

    whole = engine.resolution_x, engine.resolution_y
    left, top, width, height = options.region or (0, 0, *whole)
    rays = rays_of(eye, settings_of(depsgraph), *whole)[top : top + height, left : left + width]
    view = view_matrix_of(place_of(engine, depsgraph, eye), f"Camera {eye.name}")

    def draw(gaussians: GaussianArrays) -> Drawing:
        def draw_face(camera: Camera) -> Drawing:
            return _before_objects(depsgraph, camera, RasterizeOptions(near_plane=options.near_plane), gaussians)

        return draw_panorama(rays, view, draw_face)

    return Drawer(draw, (width, height), np.isnan(rays).any(axis=-1))
