"""Images in panels, such as the preview of a training: icons whose pixels are replaced, no data-blocks."""

import bpy.utils.previews
import numpy as np

from .. import addon_state
from ..tasks.training import TrainingState, Watchers

NAME = "training"


class PreviewIcons:
    """The state of the icons.

    Attributes:
        icons: what Blender keeps custom icons in, while the add-on is on.
        shown: the images that they show, by name.
    """

    def __init__(self) -> None:
        self.icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self.shown: dict[str, np.ndarray] = {}


def icons() -> bpy.utils.previews.ImagePreviewCollection | None:
    """The preview collection of the icons; None while the add-on is disabled."""
    return addon_state.get(PreviewIcons).icons


def show(image: np.ndarray | None, name: str = NAME) -> None:
    """Show an image (H, W, 3) uint8, rows from the top, as the icon of a name.

    The same image again costs nothing, None removes it.
    """
    preview = addon_state.get(PreviewIcons)
    if preview.icons is None or image is preview.shown.get(name):
        return
    if image is None:
        del preview.shown[name], preview.icons[name]
        return
    preview.shown[name] = image
    icon = preview.icons[name] if name in preview.icons else preview.icons.new(name)
    height, width = image.shape[:2]
    pixels = np.full((height, width, 4), 255, np.uint8)
    pixels[:, :, :3] = image[::-1]  # Blender's rows go up
    if tuple(icon.image_size) != (width, height):
        icon.image_size = (width, height)
    icon.image_pixels.foreach_set(pixels.view(np.int32).ravel())


def show_training(state: TrainingState) -> None:
    """Shows the latest preview of a training."""
    show(state.preview)


def icon_id(name: str = NAME) -> int:
    """For ``layout.template_icon``; 0 where there is no image of that name, and without a window."""
    shown = icons()
    return shown[name].icon_id if shown is not None and name in shown else 0


def draw(layout: bpy.types.UILayout, name: str = NAME) -> None:
    """Draws an image as wide as the sidebar, if there is one. It fills a square of as many rows as that is wide."""
    if icon_id(name):
        context = bpy.context
        rows = context.region.width / (20 * context.preferences.system.ui_scale) - 3 if context.region else 8
        layout.template_icon(icon_id(name), scale=min(max(rows, 6.0), 16.0))


def register() -> None:
    addon_state.get(PreviewIcons).icons = bpy.utils.previews.new()
    addon_state.get(Watchers).of_state.append(show_training)


def unregister() -> None:
    preview = addon_state.get(PreviewIcons)
    if preview.icons is not None:
        bpy.utils.previews.remove(preview.icons)
    preview.icons = None
    preview.shown.clear()
