"""torch by one button, and only by it: nothing is fetched without a click and Blender's Online Access."""

# mypy: disable-error-code="valid-type"

from typing import Any

import bpy

from ..engine.errors import FrogError
from ..torch_install import task
from ..torch_install.installer import SIZES
from ..ui import preferences


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
        return not task.is_running()

    def invoke(self, context: Any, event: Any) -> set[str]:
        text = f"This downloads {SIZES}, depending on what the package index serves."
        return context.window_manager.invoke_confirm(self, event, title="Install torch", message=text)

    def execute(self, _context: Any) -> set[str]:
        index = preferences.package_index()
        try:
            task.begin(["--index-url", index] if index else [], preferences.use_installation)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_cancel_installation(bpy.types.Operator):
    """Stop downloading; what was fetched so far is thrown away"""

    bl_idname = "frog.cancel_installation"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return task.is_running()

    def execute(self, _context: Any) -> set[str]:
        task.cancel()
        return {"FINISHED"}


_CLASSES = (FROG_OT_install_torch, FROG_OT_cancel_installation)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
