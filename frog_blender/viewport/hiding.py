"""What hides splats in a viewport: the depth that it has drawn, or that of objects' surfaces where it draws none."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ..capture_files import is_capture
from ..render.holdout import surfaces
from . import shaders

_HIDING = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL", "GPENCIL")
"""Types of objects that can lie before splats; empties can show images and collections."""
_OF_BLENDER = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT", "BLENDER_WORKBENCH")


_MOST_THROUGH_WIRES = 0.5
"""Of splats behind an object that is shown by its wires: the depth that it has is its faces', and splats that were seen
wholly would cover the wires."""


def has_others(context: bpy.types.Context) -> bool:
    """Whether a viewport may have drawn something that hides splats."""
    for obj in context.visible_objects:
        if obj.type in _HIDING and not is_capture(obj):
            return True
        if obj.type == "EMPTY" and (obj.empty_display_type == "IMAGE" or obj.instance_collection is not None):
            return True
    return False


def seen_through(shading: bpy.types.View3DShading) -> float:
    """How much is seen through what a viewport draws, in [0, 1]: Blender's X-ray."""
    if shading.type == "SOLID" and shading.show_xray:
        return 1.0 - float(shading.xray_alpha)
    if shading.type == "WIREFRAME" and shading.show_xray_wireframe:
        return min(1.0 - float(shading.xray_alpha_wireframe), _MOST_THROUGH_WIRES)
    return 0.0


def is_drawn_without_depth(scene: bpy.types.Scene, space: bpy.types.SpaceView3D) -> bool:
    """Whether a viewport has no depth: Blender draws that of Cycles' scene, as of every other engine's that is not its
    own, for its overlays alone.
    """
    is_rendered = space.shading.type == "RENDERED" and scene.render.engine not in _OF_BLENDER
    return is_rendered and not space.overlay.show_overlays


def drawn_depth() -> np.ndarray:
    """(H, W) the depth of what is bound, rows from the bottom."""
    import gpu

    framebuffer = gpu.state.active_framebuffer_get()
    x, y, width, height = framebuffer.viewport_get()
    buffer = framebuffer.read_depth(x, y, width, height)
    return np.array(buffer, np.float32, copy=False).reshape(height, width)


class Surfaces:
    """The surfaces of a scene's objects on the graphics card, which draws their depth. Put there again after changes
    alone.
    """

    def __init__(self) -> None:
        self._key: Any = None
        self._shader: Any = None
        self._batch: Any = None
        self._target: Any = None

    def has_room(self, size: tuple[int, int]) -> bool:
        """Whether a depth of that size can be drawn without making new textures."""
        return self._target is not None and self._target.size == size

    def depth(
        self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph, changes: int, size: tuple[int, int]
    ) -> Any:
        """A texture of the depth that a viewport's surfaces have, in [0, 1], rows from the bottom; None without any.

        Args:
            changes: which another number tells that the scene may have changed.
            size: of the texture.
        """
        space = context.space_data
        key = changes, context.scene.session_uid, None if space.local_view is None else space.as_pointer()
        if key != self._key:
            self._key, self._batch = key, self._made(depsgraph, space)
        if self._batch is None:
            return None
        if self._target is None or not self.has_room(size):
            self._target = Target(size)
        return self._target.draw(self._shader, self._batch, context.region_data.perspective_matrix)

    def _made(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D) -> Any:
        found = list(surfaces(depsgraph, space))
        if not found:
            return None
        if self._shader is None:
            self._shader = shaders.depth_shader()
        return surface_batch(self._shader, found)


def surface_batch(shader: Any, found: list[tuple[np.ndarray, np.ndarray]]) -> Any:
    """A GPUBatch of meshes: (V, 3) vertices and (T, 3) triangles each."""
    from gpu_extras.batch import batch_for_shader

    starts = np.cumsum([0, *(len(points) for points, _ in found)])
    points = np.concatenate([points for points, _ in found]).astype(np.float32)
    corners = np.concatenate([corners + start for (_, corners), start in zip(found, starts, strict=False)])
    return batch_for_shader(shader, "TRIS", {"place": points}, indices=corners.astype(np.int32))


class Target:
    """Where depth is drawn."""

    def __init__(self, size: tuple[int, int]) -> None:
        import gpu

        self.size = size
        self._depth = gpu.types.GPUTexture(size, format="R32F")
        self._tested = gpu.types.GPUTexture(size, format="DEPTH_COMPONENT32F")
        self._framebuffer = gpu.types.GPUFrameBuffer(color_slots=(self._depth,), depth_slot=self._tested)

    def draw(self, shader: Any, batch: Any, matrix: Any) -> Any:
        """The texture of the depth of a batch through a matrix into clip space; one where there is nothing."""
        import gpu

        with self._framebuffer.bind():
            gpu.state.active_framebuffer_get().clear(color=(1.0, 1.0, 1.0, 1.0), depth=1.0)
            gpu.state.blend_set("NONE")
            gpu.state.depth_mask_set(True)
            gpu.state.depth_test_set("LESS_EQUAL")
            shader.bind()
            shader.uniform_float("to_clip", matrix)
            batch.draw(shader)
            gpu.state.depth_mask_set(False)
            gpu.state.depth_test_set("NONE")
        return self._depth
