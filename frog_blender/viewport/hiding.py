"""What hides splats in a viewport: the depth that it has drawn, or that of objects' surfaces where it draws none."""

from typing import Any

import bpy
import gpu
import numpy as np

from ..capture_files import is_capture
from ..engine.capture.camera import Camera
from ..engine.rasterizer.mesh_depth import mesh_depth
from ..render.holdout import mesh_of
from ..scene_import.scene_setup import start_cube
from .projection import SplatView
from .views import is_frog_picture

_HIDING = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL", "GPENCIL")
"""Types of objects that can lie before splats; empties can show images and collections."""
_KINDS = ("mesh", "curve", "surf", "meta", "font", "curves", "pointcloud", "volume", "grease_pencil", "empty")
_OF_BLENDER = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT", "BLENDER_WORKBENCH")
MOST_TRIANGLES = 5_000_000  # of a viewport's surfaces, more of which take seconds
_MOST_THROUGH_WIRES = 0.5
"""Of splats behind an object that is shown by its wires: the depth that it has is its faces', and splats that were seen
wholly would cover the wires."""


def shown_kinds(space: bpy.types.SpaceView3D) -> tuple[bool, ...]:
    """Which types of objects a viewport shows, of those that hide splats or are captures."""
    return tuple(getattr(space, f"show_object_viewport_{name}") for name in _KINDS)


def _others(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The visible objects that can lie before splats. The cube of a new file does not: nobody put it there."""
    cube = start_cube(context.scene)
    return [obj for obj in context.visible_objects if obj.type in _HIDING and obj != cube and not is_capture(obj)]


def has_others(context: bpy.types.Context) -> bool:
    """Whether a viewport may have drawn something that hides splats."""
    if _others(context):
        return True
    for obj in context.visible_objects:
        if obj.type == "EMPTY" and (obj.empty_display_type == "IMAGE" or obj.instance_collection is not None):
            return True
    return False


def undrawn(context: bpy.types.Context) -> str:
    """How many objects FROG's picture in a viewport lacks, in words; "" for none."""
    scene, space = context.scene, context.space_data
    if not isinstance(space, bpy.types.SpaceView3D) or not is_frog_picture(scene, space) or scene.frog.hold_out:
        return ""
    count = sum(not (obj.frog.is_proxy or obj.hide_render) for obj in _others(context))
    return f"{count:,} object{'s are' if count > 1 else ' is'} not drawn" if count else ""


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
    framebuffer = gpu.state.active_framebuffer_get()
    x, y, width, height = framebuffer.viewport_get()
    buffer = framebuffer.read_depth(x, y, width, height)
    return np.array(buffer, np.float32, copy=False).reshape(height, width)


class Surfaces:
    """The surfaces of the objects in one viewport, read again when anything in it may have changed."""

    def __init__(self) -> None:
        self._key: Any = None
        self._mesh: tuple[np.ndarray, np.ndarray] | None = None

    def depth(self, context: bpy.types.Context, looked_at: Any, camera: Camera, view: SplatView) -> np.ndarray | None:
        """(H, W) how deep the surfaces lie, in [0, 1], rows from the bottom, 1 for nothing; None without any.

        Args:
            looked_at: what determined which captures the viewport shows, which includes whatever may have changed.
            camera: of the viewport, and ``view`` one of a capture through it.
        """
        space = context.space_data
        key = looked_at, None if space.local_view is None else space.as_pointer()
        if key != self._key:
            self._key = key  # first: what memory does not hold is not tried again
            self._mesh = mesh_of(context.evaluated_depsgraph_get(), space, MOST_TRIANGLES)
        if self._mesh is None:
            return None
        depth, (a, b, c, d) = mesh_depth(*self._mesh, camera)[::-1], view.clip
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(depth), 1.0, 0.5 + 0.5 * (a * depth + b) / (c * depth + d)).astype(np.float32)
