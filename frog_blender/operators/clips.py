"""The buttons that show and hide what a capture's cameras filmed."""

# mypy: disable-error-code="valid-type"

from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..engine.errors import FrogError
from ..engine.source_media.undistorted_clips import Undistortion
from ..scene_import.camera_clips import OPACITY, add_clips, begin_straightening, hide_clip, revive
from ..scene_import.capture_objects import cameras_of, chosen, known_by
from .modal_operator import ModalOperator, has_window


class FROG_OT_add_clips(ModalOperator, bpy.types.Operator):
    """Show each camera's own video behind what it sees, in time with the capture. Where a lens distorts, films that are
    free of it are written beside the scene's file first"""

    bl_idname = "frog.add_clips"
    bl_label = "Show Clips"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(
        name="Capture Folder",
        description="The folder with the videos or images that the capture was trained from",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    opacity: FloatProperty(
        name="Opacity",
        description="How opaque the clips are",
        default=OPACITY,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    in_front: BoolProperty(
        name="In Front",
        description="Lay the clips over what the cameras see, to compare, instead of behind it",
        default=False,
    )

    straighten: BoolProperty(
        name="Straighten",
        description="Where a lens distorts, or Blender cannot read the images as a film, write films beside the "
        "scene's file that show what the cameras saw, and show those",
        default=True,
    )

    doing = "Straightening {done:,} of {total:,} images"
    slice_seconds = 0.03
    _folder: Path | None = None
    _shown = 0
    _problem = ""
    is_interactive = False  # by a click, not by a script

    @classmethod
    def poll(cls, context: Any) -> bool:
        cls.poll_message_set("Select a capture with cameras first.")
        obj = chosen(context)
        return obj is not None and bool(cameras_of(obj))

    def invoke(self, context: Any, event: Any) -> set[str]:
        """In a window: films are written a slice at a time, and a folder is asked for where none was found."""
        self.is_interactive = True
        ended = self._show(context, None)
        if ended is None:
            context.window_manager.fileselect_add(self)
            return {"RUNNING_MODAL"}
        return ended

    def execute(self, context: Any) -> set[str]:
        """For scripts, then it comes back when all is done; and for the folder that was asked for."""
        obj = chosen(context)
        folder = Path(bpy.path.abspath(self.directory)) if self.directory else None
        ended = self._show(context, folder)
        if ended is None:
            where = folder or "The capture's folder"
            names = ", ".join(camera.name for camera in cameras_of(obj)[:3])
            nothing = f"{where}: found no clip of {obj.name}, expected images of {names} and so on."
            self.report({"ERROR"}, self._problem if folder and self._problem else nothing)
            return {"CANCELLED"}
        return ended

    def _show(self, context: Any, folder: Path | None) -> set[str] | None:
        """Write what is lacking and show; None where nothing was found to show."""
        obj = chosen(context)
        films, problem = None, ""
        try:
            films = begin_straightening(obj, folder) if self.straighten else None
        except FrogError as error:  # what there is can still be shown as it was filmed
            problem = str(error)
        self._folder = folder
        if films is not None:
            self._show_now(obj, straight=False)  # until they are written, and if they never are
            go = self.go_on_in_window if self.is_interactive and has_window(context) else self.go_through
            return go(context, self._write(films, obj.session_uid), films.total)
        try:
            self._show_now(obj, straight=self.straighten)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not self._shown:
            self._problem = problem
            return None
        if problem:
            self.report({"WARNING"}, f"The clips are shown as they were filmed: {problem}")
        else:
            self.report({"INFO"}, self.finished_sentence())
        return {"FINISHED"}

    def _write(self, films: Undistortion, capture: int) -> Generator[int, None, None]:
        """Write the films, then show them if the capture is still there."""
        yield from films.steps
        obj = known_by(bpy.data.objects, capture)
        if obj is not None:
            self._show_now(obj, straight=True)

    def _show_now(self, obj: Any, *, straight: bool) -> None:
        options = {"opacity": self.opacity, "in_front": self.in_front, "straight": straight}
        self._shown = add_clips(obj, self._folder, **options)

    def finished_sentence(self) -> str:
        return f"{self._shown} camera{'s' * (self._shown != 1)} of the capture show what they filmed."

    def stopped_sentence(self) -> str:
        return f"No films were written{'; the clips are shown as they were filmed' if self._shown else ''}."

    def failed_sentence(self, reason: str) -> str:
        return f"The clips are shown as they were filmed: {reason}" if self._shown else reason


class FROG_OT_hide_clips(bpy.types.Operator):
    """Hide what the capture's cameras filmed"""

    bl_idname = "frog.hide_clips"
    bl_label = "Hide Clips"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return FROG_OT_add_clips.poll(context)

    def execute(self, context: Any) -> set[str]:
        for camera in cameras_of(chosen(context)):
            hide_clip(camera)
        return {"FINISHED"}


_CLASSES = (FROG_OT_add_clips, FROG_OT_hide_clips)
_register_classes, unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    revive()
