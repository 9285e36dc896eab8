"""What a render looks through: the camera, the Render Region and the settings in effect, and Gaussians seen so."""

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ..cameras import distance_added, engine_camera, view_matrix_of
from ..engine.capture.camera import Camera
from ..engine.errors import FrogError
from ..engine.gaussians import GaussianArrays
from ..engine.native.options import RasterizeOptions
from ..engine.playback.environment import draw_panorama
from ..engine.playback.render import Drawing, draw
from .compositing import renders
from .holdout import draw_before, limits_of_mesh, mesh_of
from .panoramic_camera import rays_of

Through = Callable[["Camera"], "Camera"]
"""Moves a camera to a point of its lens."""


def region_of(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[int, int, int, int]:
    """Left, top, width and height in pixels of the Render Region of an image of that size; all of it without one."""
    if not render.use_border:
        return 0, 0, width, height

    def pixel(share: float, length: int) -> int:
        """Multiplied in single precision as in Blender: 0.7 of 1920 is 1344, not 1343."""
        return int(np.float32(share) * np.float32(length))

    left, right = pixel(render.border_min_x, width), pixel(render.border_max_x, width)
    bottom, top = pixel(render.border_min_y, height), pixel(render.border_max_y, height)
    return left, height - top, right - left, top - bottom


class RenderedView:
    """The view that an engine renders, always at the frame that its depsgraph is at.

    Attributes:
        size: width and height of the whole image, pixels.
    """

    def __init__(self, engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
        self.engine, self.depsgraph = engine, depsgraph
        self.size = engine.resolution_x, engine.resolution_y

    @property
    def _leading(self) -> bpy.types.Scene:
        return renders.leading(self.depsgraph.scene.original)

    @property
    def scene(self) -> bpy.types.Scene:
        """The scene whose render settings are in effect: the followed one while that is rendered."""
        scene, first = self.depsgraph.scene, self._leading
        return first if scene.original.frog.composed_with == first else scene

    @property
    def eye(self) -> bpy.types.Object:
        """The evaluated active camera: of the scene, of a sequencer strip or of a stereo eye; while the followed scene
        is rendered, the camera of that scene.
        """
        scene, first = self.depsgraph.scene.original, self._leading
        camera = self.engine.camera_override or scene.camera
        if scene.frog.composed_with == first != scene and first.camera != scene.camera:
            camera = first.camera
        if camera is None:
            raise FrogError(f"Scene {scene.name}: found no active camera, expected one to render through.")
        evaluated = camera.evaluated_get(self.depsgraph)
        if not evaluated.is_evaluated:
            raise FrogError(f"{camera.name} is not in any collection that {scene.name} renders.")
        return evaluated

    @property
    def is_panoramic(self) -> bool:
        """Whether the camera has no plane that it projects to."""
        return self.eye.type == "CAMERA" and self.eye.data.type == "PANO"

    @property
    def region(self) -> tuple[int, int, int, int]:
        """Left, top, width and height in pixels of the Render Region, which is all that Blender takes; else the image.

        Blender renders all scenes by the region of the one that the render began with.
        """
        return region_of(self._leading.render, *self.size)

    def options(self) -> RasterizeOptions:
        """Options for the Render Region, with the near plane at Blender's camera even if the engine's is further
        back.
        """
        near = RasterizeOptions.near_plane + distance_added(self.eye.data)
        return RasterizeOptions(region=self.region, near_plane=near)

    def camera(self) -> Camera:
        """The engine camera; FrogError for a panoramic one, which is none."""
        eye, render = self.eye, self.scene.render
        shift = self.engine.camera_shift_x(eye) if render.use_multiview else None
        return engine_camera(eye, self._pose(), render, *self.size, shift_x=shift)

    def rays(self) -> np.ndarray | None:
        """(H, W, 3) directions of the Render Region's pixels in a panorama, NaN where it sees nothing; None for
        another camera.
        """
        if not self.is_panoramic:
            return None
        left, top, width, height = self.region
        return rays_of(self.eye, self.scene.render, *self.size)[top : top + height, left : left + width]

    def draw(self, gaussians: GaussianArrays, rays: np.ndarray | None, through: Through | None = None) -> Drawing:
        """Draws Gaussians in the Render Region, by ``rays`` if there are any."""
        if rays is None:
            camera = self.camera()
            return self._before_objects(gaussians, through(camera) if through else camera, self.options())

        options = RasterizeOptions(near_plane=self.options().near_plane)
        view = view_matrix_of(self._pose(), f"Camera {self.eye.name}")
        return draw_panorama(rays, view, lambda face: self._before_objects(gaussians, face, options))

    def _pose(self) -> Any:
        """The matrix that places the eye: in stereo, that of the rendered view."""
        eye = self.eye
        return self.engine.camera_model_matrix(eye) if self.scene.render.use_multiview else eye.matrix_world

    def _before_objects(self, gaussians: GaussianArrays, camera: Camera, options: RasterizeOptions) -> Drawing:
        mesh = mesh_of(self.depsgraph) if self.depsgraph.scene.frog.hold_out else None
        if mesh is None:
            return draw(gaussians, camera, options=options)
        return draw_before(limits_of_mesh(*mesh, camera, options), gaussians, camera, options)
