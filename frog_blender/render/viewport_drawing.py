"""The FROG engine's viewport in a Blender window: from a region's matrices to a texture on the screen."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .. import reported_once
from ..cameras import view_camera
from ..engine.errors import FrogError
from .collect_instances import gather, scene_time, visible_captures
from .messages import error_message
from .viewport import STILL_AFTER, Viewport, ViewportImage, draw_view
from .world import background_of


def draw(engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """Draws the captures in a region. Problems are shown in the header while they last, and printed once."""
    import gpu
    from gpu_extras.presets import draw_texture_2d

    size = (context.region.width, context.region.height)
    viewport = engine.viewport = engine.viewport or Viewport()
    try:
        image = image_of(viewport, depsgraph, context.region_data, size, context.space_data)
    except (FrogError, MemoryError) as error:
        show_problems(engine, [error_message(error)])
        return
    show_problems(engine, viewport.problems)
    if viewport.shown is not image:
        height, width = image.pixels.shape[:2]
        buffer = gpu.types.Buffer("FLOAT", width * height * 4, image.pixels.reshape(-1))
        viewport.texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=buffer)
        viewport.shown = image
    gpu.state.blend_set("ALPHA_PREMULT")
    engine.bind_display_space_shader(depsgraph.scene)
    draw_texture_2d(viewport.texture, (0, 0), *size)
    engine.unbind_display_space_shader()
    gpu.state.blend_set("NONE")
    if viewport.wants_more:
        _redraw_later()


def show_problems(engine: bpy.types.RenderEngine, problems: list[str]) -> None:
    """Shows problems in the header of the viewport, or clears it."""
    for problem in problems:
        reported_once.message(problem)
    others = f" ({len(problems) - 1:,} more in the console)" if len(problems) > 1 else ""
    engine.update_stats("FRoG" if problems else "", problems[0] + others if problems else "")


def image_of(
    viewport: Viewport,
    depsgraph: bpy.types.Depsgraph,
    view: bpy.types.RegionView3D,
    size: tuple[int, int],
    space: bpy.types.SpaceView3D | None = None,
) -> ViewportImage:
    """The image of a region of that size with the matrices of ``view``, in the viewport ``space``; drawn again only if
    something has changed. Captures that cannot be drawn are listed in ``viewport.problems``.

    Raises:
        FrogError: for a view that cannot be drawn.
        MemoryError: when memory runs out.
    """
    seen = _seen(depsgraph, space)
    if viewport.gathered[0] != seen:
        problems: list[str] = []
        viewport.gathered = (seen, gather(depsgraph, space, problems))
        viewport.problems = problems
    gaussians, captured = viewport.gathered[1]
    background = background_of(depsgraph.scene, captured)
    matrices = view.view_matrix, view.window_matrix
    behind = None if background is None else background.tobytes()
    ratio = focal_ratio(depsgraph, view, space)
    key = (*(np.array(matrix).tobytes() for matrix in matrices), size, seen, behind, ratio)
    return draw_view(viewport, key, gaussians, lambda w, h: view_camera(*matrices, w, h, ratio), size, background)


def focal_ratio(
    depsgraph: bpy.types.Depsgraph, view: bpy.types.RegionView3D, space: bpy.types.SpaceView3D | None
) -> float:
    """The focal ratio of the camera of a camera view, which Blender's matrices lack; one for other views."""
    if space is None or view.view_perspective != "CAMERA":
        return 1.0
    camera = space.camera if space.use_local_camera else depsgraph.scene.camera
    return camera.data.frog.focal_ratio if camera is not None and camera.type == "CAMERA" else 1.0


def _seen(depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None) -> tuple[Any, ...]:
    """What determines the Gaussians: what the captures show as they are edited, and their matrices."""
    seen: list[tuple[Any, ...]] = []
    for obj, shown, matrix in visible_captures(depsgraph, space):
        try:
            key = scene_time(depsgraph, obj, shown, space).key
        except FrogError as error:
            seen.append((str(error), matrix.tobytes()))
        else:
            seen.append((*key, matrix.tobytes()))
    return tuple(seen)


def _redraw_later() -> None:
    if not bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.register(_redraw, first_interval=STILL_AFTER + 0.05)


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and area.spaces.active.shading.type == "RENDERED":
                area.tag_redraw()


def unregister() -> None:
    if bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.unregister(_redraw)
