"""FRoG in Blender: train dynamic Gaussian scenes from multiview video, scrub them, render them with F12.

Importing this package needs neither Blender nor torch: the engine below it runs on machines without Blender.
"""

from __future__ import annotations

from importlib import import_module

from . import edition

# In this order: properties before their users, trainings before the preview that watches them.
_ROOMS = (
    "ui.preferences",
    "ui.scene_settings",
    "ui.playback_settings",
    "ui.edit_settings",
    "timeline.handlers",
    "render.compositing.scenes",
    "render.compositing.renders",
    "render.frog_engine",
    "viewport.drawing",
    "tasks.background_task",
    "tasks.training",
    "viewport.live",
    "ui.preview_image",
    "ui.rig_overlay",
    "ui.points_overlay",
    "ui.gesture_overlay",
    "tasks.installation",
    "operators",
    "ui.selection_tools",
    "ui.presets",
    "ui.refreshing",
    "ui.capture_panel",
    "ui.train_panel",
    "ui.captures_panel",
    "ui.timing_panel",
    "ui.edit_panel",
    "ui.render_panel",
    "ui.render_panels",
    "ui.menus",
    "ui.status_bar",
)


def _rooms() -> list[str]:
    return [room for room in _ROOMS if edition.has(room)]


def _call(room: str, name: str) -> None:
    """Calls a function of a room, if it has it: some have nothing to register, some nothing to take back."""
    function = getattr(import_module(f".{room}", __package__), name, None)
    if function is not None:
        function()


def register() -> None:
    """Called by Blender when the add-on is enabled."""
    for room in _rooms():
        _call(room, "register")


def unregister() -> None:
    """Called by Blender when the add-on is disabled, and when Blender quits."""
    for room in reversed(_rooms()):
        _call(room, "unregister")
    import_module(".addon_state", __package__).clear()
