"""Install torch, or what calibration needs. Nothing is downloaded without a click and without Online Access."""

# mypy: disable-error-code="valid-type"

import bpy

from ..engine.capture.calibration.landmark_file import LICENSE, landmark_file
from ..engine.capture.calibration.landmark_file import SIZES as LANDMARK_SIZES
from ..engine.errors import FrogError
from ..torch_install import task
from ..torch_install.packages import CALIBRATION_SIZES, PYCOLMAP, SIZES, has_pycolmap_wheel
from ..ui import preferences


def may_download(operator: type[bpy.types.Operator]) -> bool:
    """Whether the user allows downloads and none is running; otherwise it says why not."""
    if not bpy.app.online_access:
        operator.poll_message_set("Enable Online Access in Preferences > System first.")
        return False
    operator.poll_message_set("An installation is already running.")
    return not task.is_running()


class FROG_OT_install_torch(bpy.types.Operator):
    """Download torch, OpenCV and pycolmap into a separate folder. Blender itself is not changed"""

    bl_idname = "frog.install_torch"
    bl_label = "Install torch"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return may_download(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        text = f"This downloads {SIZES}, depending on what the package index serves."
        return context.window_manager.invoke_confirm(self, event, title="Install torch", message=text)

    def execute(self, _context: bpy.types.Context) -> set[str]:
        index = preferences.package_index()
        try:
            # Besides pip's own, which alone has the other packages.
            task.begin(["--extra-index-url", index] if index else [], preferences.use_installation)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_install_calibration(bpy.types.Operator):
    """Download pycolmap and OpenCV, which calibration needs, into a separate folder. Blender itself is not changed"""

    bl_idname = "frog.install_calibration"
    bl_label = "Install pycolmap"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        cls.poll_message_set("There is no pycolmap for this kind of computer.")
        return has_pycolmap_wheel() and may_download(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        text = f"This downloads pycolmap {PYCOLMAP} and OpenCV, {CALIBRATION_SIZES}."
        return context.window_manager.invoke_confirm(self, event, title="Install pycolmap", message=text)

    def execute(self, _context: bpy.types.Context) -> set[str]:
        try:  # from pip's own index: PyTorch's has no pycolmap
            task.begin_calibration([], preferences.add_folder)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_fetch_landmarks(bpy.types.Operator):
    """Download the file that finds a person's joints, by which cameras that stand far apart can be calibrated"""

    bl_idname = "frog.fetch_landmarks"
    bl_label = "Fetch Landmark File"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        cls.poll_message_set("The landmark file is there.")
        return landmark_file() is None and may_download(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        text = f"This downloads {LICENSE}: {LANDMARK_SIZES}."
        return context.window_manager.invoke_confirm(self, event, title="Fetch Landmark File", message=text)

    def execute(self, _context: bpy.types.Context) -> set[str]:
        try:
            task.begin_landmarks()
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class FROG_OT_cancel_installation(bpy.types.Operator):
    """Stop the download and discard what was downloaded so far"""

    bl_idname = "frog.cancel_installation"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return task.is_running()

    def execute(self, _context: bpy.types.Context) -> set[str]:
        task.cancel()
        return {"FINISHED"}


_CLASSES = (FROG_OT_install_torch, FROG_OT_install_calibration, FROG_OT_fetch_landmarks, FROG_OT_cancel_installation)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
