"""The image in the panel that shows how a training stands: one icon that takes new pixels, no data-block."""

from __future__ import annotations

import bpy.utils.previews
import numpy as np

from .. import addon_state
from ..training_task import runner
from ..training_task.state import TrainingState

NAME = "training"


class PreviewIcon:
    """The icon.

    Attributes:
        icons: what Blender keeps custom icons in, while the add-on is on.
        shown: the image that it shows.
    """

    def __init__(self) -> None:
        self.icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self.shown: np.ndarray | None = None


def _icon() -> PreviewIcon:
    return addon_state.get(PreviewIcon)


def icons() -> bpy.utils.previews.ImagePreviewCollection | None:
    """What Blender keeps the icon in; None while the add-on is off."""
    return _icon().icons


def show(image: np.ndarray | None) -> None:
    """Make (H, W, 3) uint8, rows from the top, the image; the same one again costs nothing, None takes it away."""
    preview = _icon()
    if preview.icons is None or image is preview.shown:
        return
    preview.shown = image
    if image is None:
        preview.icons.clear()
        return
    icon = preview.icons[NAME] if NAME in preview.icons else preview.icons.new(NAME)
    height, width = image.shape[:2]
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[:, :, :3] = image[::-1]  # Blender's rows go up
    if tuple(icon.image_size) != (width, height):
        icon.image_size = (width, height)
    icon.image_pixels.foreach_set(pixels.view(np.int32).ravel())


def show_training(state: TrainingState) -> None:
    """Makes the latest preview of a training the image."""
    show(state.preview)


def icon_id() -> int:
    """For ``layout.template_icon``; 0 where there is no image, and without a window."""
    found = icons()
    return found[NAME].icon_id if found is not None and NAME in found else 0


def register() -> None:
    _icon().icons = bpy.utils.previews.new()
    runner.watch(show_training)


def unregister() -> None:
    preview = _icon()
    if preview.icons is not None:
        bpy.utils.previews.remove(preview.icons)
    preview.icons = preview.shown = None
