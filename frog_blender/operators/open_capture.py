"""Choosing the capture to train from: by dropping its videos, calibrated or raw, or its folder in File > Import."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, StringProperty

from ..engine.capture.video import VIDEO_SUFFIXES
from ..engine.errors import FrogError
from ..properties import text
from ..scene_import.capture_objects import find_by_uid
from ..ui.capture_reading import CaptureReading
from ..ui.sidebar_panel import show_tab
from ..ui.training_settings import choose_capture
from .bases import UNDOABLE
from .modal_operator import ModalOperator, Steps

_WAIT = 0.01  # seconds: shorter than what anybody notices


class OpensCapture(ModalOperator):
    """A base next to ``bpy.types.Operator``: reads a folder, beside the main thread in a window, and makes it the
    scene's capture; an error changes nothing.
    """

    doing = "Reading the capture"
    stop_keys = ("ESC",)
    stopped = "No capture was chosen."
    at_once = 0.03  # seconds: for a folder whose films are long, of which nothing is decoded

    def folder(self) -> Path:
        """The folder that is opened; FrogError if there is none."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        steps = self._reading(context.scene.session_uid)
        return self.run(context, steps, 1, in_window=self.has_window(context))

    def _reading(self, uid: int) -> Steps:
        folder = self.folder()
        reading = CaptureReading(str(folder)).start()
        while reading.is_running:
            reading.join(_WAIT if self.timer is None else 0.0)
            reading.pump()
            if reading.is_running:
                yield 0
        summary = reading.result
        if summary.error:
            raise FrogError(summary.error)
        scene = find_by_uid(bpy.data.scenes, uid)
        if scene is None:
            raise FrogError(f"{folder}: the scene that it was chosen for is not there any more.")
        choose_capture(scene.frog, str(folder), summary)
        self.has_changed_file = True
        self.said = f"{folder.name}: {'; '.join(summary.lines)}"
        _show_panel(bpy.context)


class FROG_OT_drop_videos(OpensCapture, bpy.types.Operator):
    """Use the folder of these videos for training and show what was found in it"""

    bl_label = "FRoG Capture of These Videos"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})

    def folder(self) -> Path:
        if not self.files:
            raise FrogError("Found no video, expected the videos of one capture.")
        return Path(self.directory)


class FROG_FH_videos(bpy.types.FileHandler):
    """Lets the videos of a capture be dropped into a 3D viewport."""

    bl_label = "FRoG Capture"
    bl_import_operator = "frog.drop_videos"
    bl_file_extensions = ";".join(sorted(VIDEO_SUFFIXES))

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


class FROG_OT_import_capture(OpensCapture, bpy.types.Operator):
    """Choose the folder with the videos or images to train from. The Train panel shows a summary of it"""

    bl_idname = "import_scene.frog_capture"
    bl_label = "Open FRoG Capture"
    import_menu = "FRoG Capture (folder)"
    bl_options = UNDOABLE

    directory: text(
        "Capture",
        "Folder with the videos or images and their camera calibration",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_movie: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def folder(self) -> Path:
        return Path(bpy.path.abspath(self.directory))


def _show_panel(context: bpy.types.Context) -> None:
    """Shows the FRoG tab of the sidebar, in the viewport that the capture was dropped into or else in the largest."""
    views = [area for area in context.screen.areas if area.type == "VIEW_3D"] if context.screen is not None else []
    if not views:
        return
    area = context.area if context.area in views else max(views, key=lambda view: view.width * view.height)
    area.spaces.active.show_region_ui = True
    if not bpy.app.background:
        show_tab(area)
