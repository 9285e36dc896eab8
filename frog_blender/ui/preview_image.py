"""The preview of a training in panels: an icon whose pixels are replaced, no data-block."""

import bpy.utils.previews
import numpy as np

from .. import addon_state
from ..tasks.training import TrainingState, Watchers

NAME = "training"


class PreviewIcons:
    """The state of the icon.

    Attributes:
        icons: what Blender keeps custom icons in, while the add-on is on.
        shown: the image that the icon shows, if there is one.
    """

    def __init__(self) -> None:
        self.icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self.shown: np.ndarray | None = None


def icons() -> bpy.utils.previews.ImagePreviewCollection | None:
    """The preview collection of the icon; None while the add-on is disabled."""
    return addon_state.get(PreviewIcons).icons


def show(image: np.ndarray | None) -> None:
    """Show an image (H, W, 3) uint8, rows from the top; the same one again costs nothing, None removes it."""
    preview = addon_state.get(PreviewIcons)
    if preview.icons is None or image is preview.shown:
        return
    preview.shown = image
    if image is None:
        del preview.icons[NAME]
        return
    icon = preview.icons[NAME] if NAME in preview.icons else preview.icons.new(NAME)
    height, width = image.shape[:2]
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[:, :, :3] = image[::-1]  # Blender's rows go up
    if tuple(icon.image_size) != (width, height):
        icon.image_size = (width, height)
    icon.image_pixels.foreach_set(pixels.view(np.int32).ravel())


def show_training(state: TrainingState) -> None:
    """Shows the latest preview of a training."""
    show(state.preview)


def icon_id() -> int:
    """For ``layout.template_icon``; 0 where there is no image, and without a window."""
    shown = icons()
    return shown[NAME].icon_id if shown is not None and NAME in shown else 0


def draw(layout: bpy.types.UILayout) -> None:
    """Draws the image as wide as the sidebar, if there is one. It fills a square of as many rows as that is wide."""
    if icon_id():
        context = bpy.context
        rows = context.region.width / (20 * context.preferences.system.ui_scale) - 3 if context.region else 8
        layout.template_icon(icon_id(), scale=min(max(rows, 6.0), 16.0))


def register() -> None:
    addon_state.get(PreviewIcons).icons = bpy.utils.previews.new()
    addon_state.get(Watchers).of_state.append(show_training)


def unregister() -> None:
    preview = addon_state.get(PreviewIcons)
    if preview.icons is not None:
        bpy.utils.previews.remove(preview.icons)
    preview.icons = preview.shown = None
