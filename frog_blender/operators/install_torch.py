"""torch by one button, and only by it: nothing is fetched without a click and Blender's Online Access."""

# mypy: disable-error-code="valid-type"

import threading
from pathlib import Path
from typing import Any

import bpy

from .. import __package__ as base_package
from ..engine.errors import FrogError
from ..torch_install.folders import clear_remains, remains
from ..torch_install.installer import SIZES, Installation
from ..ui import preferences

current: Installation | None = None  # the one that runs, or the last that ran
_TICK = 0.5


def folder() -> Path:
    """Where this add-on's torch lies: with the user's extensions, so that it outlives upgrades of the add-on."""
    return Path(bpy.utils.user_resource("DATAFILES", path="frog_blender")) / "torch"


class FROG_OT_install_torch(bpy.types.Operator):
    """Download torch and OpenCV, which training needs, into a folder of their own. Blender stays as it is"""

    bl_idname = "frog.install_torch"
    bl_label = "Install torch"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        if not bpy.app.online_access:
            cls.poll_message_set("Allow Online Access in Preferences > System first.")
            return False
        cls.poll_message_set("An installation is running.")
        return current is None or not current.running

    def invoke(self, context: Any, event: Any) -> set[str]:
        text = f"This downloads {SIZES}, depending on what the package index serves."
        return context.window_manager.invoke_confirm(self, event, title="Install torch", message=text)

    def execute(self, context: Any) -> set[str]:
        global current
        index = context.preferences.addons[base_package].preferences.package_index.strip() if _has_preferences() else ""
        try:
            current = Installation(folder(), ["--index-url", index] if index else []).start()
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not bpy.app.timers.is_registered(_tick):
            bpy.app.timers.register(_tick, first_interval=_TICK, persistent=True)
        return {"FINISHED"}


class FROG_OT_cancel_installation(bpy.types.Operator):
    """Stop downloading; what was fetched so far is thrown away"""

    bl_idname = "frog.cancel_installation"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return current is not None and current.running

    def execute(self, _context: Any) -> set[str]:
        assert current is not None
        current.cancel()
        return {"FINISHED"}


def adopt() -> bool:
    """Names a finished installation in the preferences; True when there was one."""
    if current is None or not current.done:
        return False
    if _has_preferences():
        bpy.context.preferences.addons[base_package].preferences.torch_path = str(current.folder)
    preferences.add_folder(current.folder)
    return True


def _has_preferences() -> bool:
    return base_package in bpy.context.preferences.addons


def _tick() -> float | None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("PREFERENCES", "VIEW_3D"):
                area.tag_redraw()
    if current is not None and current.running:
        return _TICK
    adopt()
    return None


_CLASSES = (FROG_OT_install_torch, FROG_OT_cancel_installation)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    place = folder()
    if remains(place):  # gigabytes, which take a while
        threading.Thread(target=clear_remains, args=(place,), name="FRoG tidying", daemon=True).start()


def unregister() -> None:
    global current
    if current is not None:
        current.cancel()
        current.join(10.0)
        current = None
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _unregister_classes()
