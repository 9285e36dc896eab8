"""The FROG engine's viewport in a Blender window: from a region's matrices to a texture on the screen."""

from __future__ import annotations

import sys
from typing import Any

import bpy
import numpy as np

from .. import playback
from ..blender_camera import view_camera
from ..engine.errors import FrogError
from ..render_engine import background_of, gather, visible_captures
from .viewport import STILL_AFTER, Viewport, draw_view

_said: set[str] = set()


def draw(engine: Any, context: Any, depsgraph: Any) -> None:
    """Draws the captures as the region sees them; what cannot be drawn is said in the header, once in the console."""
    import gpu
    from gpu_extras.presets import draw_texture_2d

    region, view = context.region, context.region_data
    size = (region.width, region.height)
    viewport = engine.viewport = engine.viewport or Viewport()
    try:
        key = _key(depsgraph, view, size)
        if viewport.gathered[0] != key[1:]:
            viewport.gathered = (key[1:], gather(depsgraph))
        gaussians, captured = viewport.gathered[1]
        background = background_of(depsgraph.scene, captured)
        matrices = view.view_matrix, view.window_matrix
        picture = draw_view(viewport, key, gaussians, lambda w, h: view_camera(*matrices, w, h), size, background)
    except FrogError as error:
        engine.update_stats("FRoG", str(error))
        if str(error) not in _said:
            _said.add(str(error))
            print(f"FRoG: {error}", file=sys.stderr)
        return
    if viewport.shown is not picture:
        height, width = picture.pixels.shape[:2]
        buffer = gpu.types.Buffer("FLOAT", width * height * 4, picture.pixels.reshape(-1))
        viewport.texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=buffer)
        viewport.shown = picture
    gpu.state.blend_set("ALPHA_PREMULT")
    engine.bind_display_space_shader(depsgraph.scene)
    draw_texture_2d(viewport.texture, (0, 0), *size)
    engine.unbind_display_space_shader()
    gpu.state.blend_set("NONE")
    if viewport.wants_more:
        _redraw_later()


def _key(depsgraph: Any, view: Any, size: tuple[int, int]) -> tuple[Any, ...]:
    """What decides the picture: first the view, then what is seen."""
    frame = depsgraph.scene.frame_current_final
    seen = tuple(
        (str(file), playback.version(file), playback.shown_frame(obj, frame), matrix.tobytes())
        for file, obj, matrix in ((playback.file_of(obj), obj, matrix) for obj, matrix in visible_captures(depsgraph))
    )
    look = (*size, np.array(view.view_matrix).tobytes(), np.array(view.window_matrix).tobytes())
    return look, seen


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
