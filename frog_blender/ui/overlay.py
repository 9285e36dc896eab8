"""What is drawn over Blender's editors."""

from collections.abc import Callable, Sequence
from typing import Any

import blf
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from .. import reported_once

EDGE = (0.0, 0.0, 0.0, 0.8)
"""Of lines that have to be seen on any image."""


class Overlay:
    """Functions of Blender's that draw while something is shown.

    Attributes:
        handlers: what Blender gave for them, with the editor of each.
    """

    def __init__(self) -> None:
        self.handlers: list[tuple[Any, Any]] = []

    def draw_by(self, space: Any, what: str, draw: Callable[[], None], when: str = "POST_PIXEL") -> None:
        """Lets ``draw`` draw over a type of editor until ``end``. An error is told once, not at every redraw."""

        def guarded() -> None:
            try:
                draw()
            except Exception as error:
                reported_once.unexpected(f"drawing {what}", error)

        self.handlers.append((space, space.draw_handler_add(guarded, (), "WINDOW", when)))

    def end(self) -> None:
        """Draws nothing more."""
        for space, handler in self.handlers:
            space.draw_handler_remove(handler, "WINDOW")
        self.handlers.clear()


def draw_lines(lines: dict[str, Any], strokes: Sequence[tuple[tuple[float, ...], float]]) -> None:
    """Draws lines with every stroke, one over the other.

    Args:
        lines: points in pixels, by what they are, such as ``LINE_STRIP``.
        strokes: a colour and a width in pixels.
    """
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batches = [batch_for_shader(shader, kind, {"pos": points}) for kind, points in lines.items()]
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    for color, width in strokes:
        shader.uniform_float("color", color)
        shader.uniform_float("lineWidth", width)
        for batch in batches:
            batch.draw(shader)
    gpu.state.blend_set("NONE")


def draw_text(words: str, x: float, y: float, size: float, color: tuple[float, ...]) -> None:
    """Draws a line of text with a shadow, at a pixel, in a size in pixels."""
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 5, 0.0, 0.0, 0.0, 1.0)
    blf.size(0, size)
    blf.color(0, *color)
    blf.position(0, x, y, 0)
    blf.draw(0, words)
    blf.disable(0, blf.SHADOW)


def distance_to(lines: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(...) pixels from a point (2,) to lines (..., 2, 2) on the screen, of which each has two ends."""
    starts, steps = lines[..., 0, :], lines[..., 1, :] - lines[..., 0, :]
    along = ((point - starts) * steps).sum(-1) / np.maximum((steps**2).sum(-1), 1e-12)
    away = point - starts - np.clip(along, 0, 1)[..., None] * steps
    return np.asarray(np.linalg.norm(away, axis=-1))
