"""What is drawn with the mouse to select Gaussians, and what it hits so far, over the viewport it is drawn in."""

import math

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from .. import addon_state
from ..engine.editing.gestures import Gesture, OnScreen
from .overlay import EDGE, Overlay, draw_lines

_HIT, _POINT_SIZE = (1.0, 0.55, 0.1, 1.0), 4.0  # pixels
_STROKES = ((EDGE, 3.0), ((1.0, 1.0, 1.0, 1.0), 1.0))


class GestureOverlay(Overlay):
    """What draws a gesture."""


def begin(screen: OnScreen, gesture: Gesture, shape: str, radius: float, region: bpy.types.Region) -> None:
    """Draws a gesture in a region until ``end``."""
    end()
    pointer = region.as_pointer()

    def draw() -> None:
        if bpy.context.region.as_pointer() == pointer:
            _draw(screen, gesture, outline_of(shape, gesture.path, radius))

    addon_state.get(GestureOverlay).draw_by(bpy.types.SpaceView3D, "the selection", draw)


def end() -> None:
    """Draws nothing more."""
    addon_state.get(GestureOverlay).end()


def outline_of(shape: str, path: list[tuple[float, float]], radius: float) -> list[tuple[float, float]]:
    """The line to draw: around the brush where it is, along the lasso and back, around the box."""
    if not path:
        return []
    (x, y), (left, top) = path[-1], path[0]
    if shape == "BRUSH":
        return [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in (math.tau * i / 48 for i in range(49))]
    return [*path, path[0]] if shape == "LASSO" else [(left, top), (x, top), (x, y), (left, y), (left, top)]


def _draw(screen: OnScreen, gesture: Gesture, outline: list[tuple[float, float]]) -> None:
    context = bpy.context
    height = context.region.height
    if gesture.hit.any():
        x, y = screen.places[:, gesture.hit]
        places = np.stack([x, height - y], axis=1)
        gpu.state.blend_set("ALPHA")
        shader = gpu.shader.from_builtin("POINT_UNIFORM_COLOR")
        shader.uniform_float("color", _HIT)
        gpu.state.point_size_set(_POINT_SIZE * context.preferences.system.pixel_size)
        batch_for_shader(shader, "POINTS", {"pos": places}).draw(shader)
        gpu.state.point_size_set(1.0)
        gpu.state.blend_set("NONE")
    line = [(x, height - y) for x, y in outline]
    if len(line) > 1:
        draw_lines({"LINE_STRIP": line}, _STROKES)


unregister = end
