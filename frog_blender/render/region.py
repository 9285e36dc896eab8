"""The part of the image that Blender renders."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import bpy


def rendered_part(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[int, int, int, int]:
    """Left, top, width and height in pixels of the Render Region, which is all that Blender takes; else the image.

    Args:
        render: settings of the scene that the render began with: Blender renders all others by its region.
        width, height: of the whole image.
    """
    if not render.use_border:
        return 0, 0, width, height

    def pixel(share: float, length: int) -> int:
        """Multiplied in single precision as in Blender: 0.7 of 1920 is 1344, not 1343."""
        return int(np.float32(share) * np.float32(length))

    left, right = pixel(render.border_min_x, width), pixel(render.border_max_x, width)
    bottom, top = pixel(render.border_min_y, height), pixel(render.border_max_y, height)
    return left, height - top, right - left, top - bottom
