"""FRoG in Blender: train dynamic Gaussian scenes from multiview video, scrub them, render them with F12.

Importing this package needs neither Blender nor torch: the engine below it runs on machines without Blender.
"""

from importlib import import_module
from types import ModuleType

from . import edition

# In this order: properties before their users, trainings before the preview that watches them.
_ROOMS = (
    "ui.preferences",
    "ui.rig_settings",
    "ui.scene_settings",
    "ui.playback_settings",
    "ui.edit_settings",
    "timeline.handlers",
    "render.compositing.scenes",
    "render.compositing.renders",
    "render.frog_engine",
    "viewport.drawing",
    "viewport.views",
    "tasks.background_task",
    "tasks.training",
    "viewport.live",
    "ui.preview_image",
    "ui.rig_overlay",
    "ui.gesture_overlay",
    "ui.crop_frames",
    "tasks.installation",
    "operators",
    "ui.selection_tools",
    "ui.refreshing",
    "ui.capture_panel",
    "ui.train_panel",
    "ui.captures_panel",
    "ui.timing_panel",
    "ui.edit_panel",
    "ui.render_panel",
    "ui.render_panels",
    "ui.graphics_card",
    "ui.menus",
    "ui.status_bar",
)


def _rooms() -> list[ModuleType]:
    return [import_module(f".{room}", __package__) for room in _ROOMS if edition.has(room)]


def register() -> None:
    """Called by Blender when the add-on is enabled."""
    from . import registration

    for room in _rooms():
        registration.register(room)


def unregister() -> None:
    """Called by Blender when the add-on is disabled, and when Blender quits."""
    from . import addon_state, registration

    for room in reversed(_rooms()):
        registration.unregister(room)
    addon_state.clear()
