"""What hides splats in a viewport: the depth that it has drawn, or that of objects' surfaces where it draws none."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from .. import reported_once
from ..capture_files import is_capture
from ..render.holdout import Surface, surfaces

_HIDING = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL", "GPENCIL")
"""Types of objects that can lie before splats; empties can show images and collections."""
_KINDS = ("mesh", "curve", "surf", "meta", "font", "curves", "pointcloud", "volume", "grease_pencil", "empty")
_OF_BLENDER = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT", "BLENDER_WORKBENCH")
_QUICK = 0.01  # seconds of reading surfaces, which an image may take longer
MOST_TRIANGLES, MOST_BOXES = 2_000_000, 10_000
"""Of a viewport's surfaces."""
_BOX_CORNERS = np.array([[corner & 1, corner & 2, corner & 4] for corner in range(8)], bool)
_BOX_TRIANGLES = np.array(
    [
        *([0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4]),
        *([2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]),
    ],
    np.int32,
)
_MOST_THROUGH_WIRES = 0.5
"""Of splats behind an object that is shown by its wires: the depth that it has is its faces', and splats that were seen
wholly would cover the wires."""


def shown_kinds(space: bpy.types.SpaceView3D) -> tuple[bool, ...]:
    """Which types of objects a viewport shows, of those that hide splats or are captures."""
    return tuple(getattr(space, f"show_object_viewport_{name}") for name in _KINDS)


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
    """The surfaces of the objects in one viewport on the graphics card, which draws their depth."""

    def __init__(self) -> None:
        self._key: Any = None
        self._batch: Any = None
        self._target: Any = None
        self._seconds = 0.0
        self.is_outdated = False

    def has_room(self, size: tuple[int, int]) -> bool:
        """Whether a depth of that size can be drawn without making new textures."""
        return self._batch is None or (self._target is not None and self._target.size == size)

    def update(self, shader: Any, context: bpy.types.Context, looked_at: Any, *, is_still: bool) -> None:
        """Puts there what a viewport shows; sets ``is_outdated`` where that has to wait until nothing moves.

        Every frame and every selection may have changed any object: whether it has is only known once all are read. So
        playback goes on with the surfaces of before where reading them takes longer than an image may.

        Args:
            looked_at: what determined which captures the viewport shows, which includes whatever may have changed.
            is_still: whether nothing has changed for a while.
        """
        space = context.space_data
        key = looked_at, None if space.local_view is None else space.as_pointer()
        self.is_outdated = key != self._key and self._key is not None and not is_still and self._seconds > _QUICK
        if key == self._key or self.is_outdated:
            return
        begun = time.perf_counter()
        self._key, self._batch = key, None  # before there are two; and what memory does not hold is not tried again
        found = within(surfaces(context.evaluated_depsgraph_get(), space))
        self._batch = surface_batch(shader, found) if found else None
        self._seconds = time.perf_counter() - begun

    def depth(self, shader: Any, matrix: Any, size: tuple[int, int]) -> Any:
        """A texture of that size of how deep the surfaces lie, in [0, 1], rows from the bottom; None without any.

        Args:
            matrix: (4, 4) from the world to clip space.
        """
        if self._batch is None:
            return None
        if self._target is None or not self.has_room(size):
            self._target = None  # before there are two
            self._target = Target(size)
        return self._target.draw(shader, self._batch, matrix)


def within(
    found: Iterable[Surface], most: int = MOST_TRIANGLES, most_boxes: int = MOST_BOXES
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(V, 3) vertices in world space and (T, 3) triangles of surfaces, of so many triangles and vertices at most.

    Those beyond are their bounding boxes, or left out where these are too many as well: what fills a card's memory, or
    takes seconds, is worse than splats that are hidden roughly.
    """
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    room, boxes = most, 0
    boxed, box = None, np.empty((0, 3), np.float32)
    for surface in found:
        size = max(len(surface.vertices), len(surface.triangles))
        if size <= room:
            room -= size
            parts.append((surface.placed(), surface.triangles))
        elif boxes < most_boxes:
            boxes += 1
            if surface.vertices is not boxed:  # instances of one mesh mostly follow each other
                boxed, box = surface.vertices, _box(surface.vertices)
            parts.append((replace(surface, vertices=box).placed(), _BOX_TRIANGLES))
        else:
            break
    if boxes:
        reported_once.message(
            f"Without overlays, objects of more than {most:,} triangles hide splats by their bounding boxes. Show the "
            "viewport's overlays for their shapes."
        )
    return parts


def _box(points: np.ndarray) -> np.ndarray:
    """(8, 3) the corners of the bounding box of points."""
    return np.where(_BOX_CORNERS, points.max(axis=0), points.min(axis=0)).astype(np.float32)


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
