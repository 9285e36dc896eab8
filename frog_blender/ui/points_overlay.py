"""The points that are being clicked, drawn over a camera's image with their numbers."""

import math

import bpy

from .. import addon_state
from .clicked_points import ClickedPoints
from .overlay import EDGE, Overlay, draw_lines, draw_text

IMAGE = "FRoG camera"
_RADIUS = 7.0  # pixels of the screen
_SET, _NEXT = (1.0, 0.8, 0.2, 1.0), (0.35, 1.0, 0.4, 1.0)


class PointsOverlay(Overlay):
    """What is drawn.

    Attributes:
        points: that are clicked.
        image: the name of the image that they lie in.
        is_drawn: it was; only then the editor's size is known.
    """

    def __init__(self) -> None:
        super().__init__()
        self.points: ClickedPoints | None = None
        self.image = ""
        self.is_drawn = False


def begin(points: ClickedPoints) -> None:
    """Draws points over ``show``'s image until ``end``."""
    overlay = addon_state.get(PointsOverlay)
    overlay.end()
    overlay.points = points
    overlay.draw_by(bpy.types.SpaceImageEditor, "the clicked points", _draw)


def end() -> None:
    """Draws nothing more."""
    overlay = addon_state.get(PointsOverlay)
    overlay.end()
    overlay.points, overlay.image = None, ""


def show(image: bpy.types.Image) -> None:
    """The image that the points lie in."""
    overlay = addon_state.get(PointsOverlay)
    overlay.image, overlay.is_drawn = image.name, False


def is_drawn() -> bool:
    """Whether the image was drawn: only then the editor can fit it into its region."""
    return addon_state.get(PointsOverlay).is_drawn


def told(points: ClickedPoints) -> str:
    """What is to be done now, in a line."""
    camera = f"{points.name} ({points.camera + 1} of {len(points.cameras)})"
    doing = "add" if points.point >= points.count else "click"
    return f"{camera}: {doing} point {points.point + 1}, {points.seen_in(points.name)} set"


KEYS = "Tab: next camera    N: not visible here    Up, Down: other point    Ctrl Z: undo    Enter: done"


def _draw() -> None:
    overlay, context = addon_state.get(PointsOverlay), bpy.context
    points, image = overlay.points, context.space_data.image
    if points is None or image is None or image.name != overlay.image:
        return
    overlay.is_drawn = True
    scale = context.preferences.system.ui_scale
    width, height = image.size
    for index, pixel in enumerate(points.of(points.name)):
        if pixel is None:
            continue
        view = context.region.view2d
        x, y = view.view_to_region(pixel[0] / width, 1 - pixel[1] / height, clip=False)
        color = _NEXT if index == points.point else _SET
        _cross(x, y, _RADIUS * scale, color)
        draw_text(str(index + 1), x + _RADIUS * scale, y + _RADIUS * scale, 13 * scale, color)
    draw_text(told(points), 12 * scale, context.region.height - 56 * scale, 15 * scale, _NEXT)
    draw_text(KEYS, 12 * scale, context.region.height - 76 * scale, 12 * scale, (0.9, 0.9, 0.9, 1.0))


def _cross(x: float, y: float, radius: float, color: tuple[float, ...]) -> None:
    """A circle with its middle left free, so that what is marked stays visible."""
    around = [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in (math.tau * i / 24 for i in range(25))]
    arms = [(x + a * radius * s, y + b * radius * s) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1)) for s in (0.4, 1.5)]
    draw_lines({"LINE_STRIP": around, "LINES": arms}, ((EDGE, 4.0), (color, 2.0)))


unregister = end
