"""The image in the panel that shows how a training stands: one icon that takes new pixels, no data-block."""

from __future__ import annotations

from typing import Any

import bpy.utils.previews
import numpy as np

_NAME = "training"
_icons: Any = None  # what Blender keeps custom icons in, while the add-on is on
_shown: np.ndarray | None = None


def show(image: np.ndarray | None) -> None:
    """Make (H, W, 3) uint8, rows from the top, the image; the same one again costs nothing, None takes it away."""
    global _shown
    if _icons is None or image is _shown:
        return
    _shown = image
    if image is None:
        _icons.clear()
        return
    icon = _icons[_NAME] if _NAME in _icons else _icons.new(_NAME)
    height, width = image.shape[:2]
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[:, :, :3] = image[::-1]  # Blender's rows go up
    if tuple(icon.image_size) != (width, height):
        icon.image_size = (width, height)
    icon.image_pixels.foreach_set(pixels.view(np.int32).ravel())


def icon_id() -> int:
    """For ``layout.template_icon``; 0 where there is no image, and without a window."""
    return _icons[_NAME].icon_id if _icons is not None and _NAME in _icons else 0


def register() -> None:
    global _icons
    _icons = bpy.utils.previews.new()


def unregister() -> None:
    global _icons, _shown
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
    _icons = _shown = None
