"""Show Clips and Hide Clips: the videos of a capture's cameras as their backgrounds."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy
from bpy.props import BoolProperty

from ..engine.errors import FrogError
from ..engine.source_media.undistorted_clips import Undistortion
from ..properties import text
from ..scene_import.camera_clips import add_clips, begin_undistortion, hide_clip, refresh_drivers
from ..scene_import.capture_objects import active_capture, cameras_of, find_by_uid
from ..viewport import drawing
from .bases import UNDOABLE, FrogOperator, UndoableOperator
from .modal_operator import ModalOperator, Steps


class _NoClipsError(FrogError):
    """There is nothing to show."""


class _OfCameras(FrogOperator):
    """Base of operators on the cameras of the active capture."""

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        obj = active_capture(context)
        return "" if obj is not None and cameras_of(obj) else "Select a capture with cameras first."


class FROG_OT_add_clips(_OfCameras, ModalOperator, bpy.types.Operator):
    """Show each camera's video as its background, synchronized with the capture. For lenses with distortion, \
undistorted copies are first written next to the scene file"""

    bl_label = "Show Clips"
    bl_options = UNDOABLE

    directory: text(
        "Capture Folder",
        "The folder with the videos or images that the capture was trained from",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    doing = "Undistorting {done:,} of {total:,} images"
    slice_seconds = 0.03
    _folder: Path | None = None
    _shown = 0
    _in_front = False
    _problem = _hint = ""

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.is_interactive = True
        return self.execute(context)

    def failed(self, error: FrogError) -> set[str]:
        """Asks for the capture's folder where it was not found."""
        if not self.is_interactive or self.directory or not isinstance(error, _NoClipsError):
            return super().failed(error)
        bpy.context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        """Shows the clips that there are, and writes the missing ones."""
        obj, films, self._problem = active_capture(context), None, ""
        self._in_front = self.is_interactive and _is_covered(context)
        self._hint = " Look through one to see its clip." if self.is_interactive else ""
        self._folder = Path(bpy.path.abspath(self.directory)) if self.directory else None
        try:
            films = begin_undistortion(obj, self._folder)
        except FrogError as error:  # the original clips can still be shown
            self._problem = str(error)
        self._show(obj, straight=films is None)
        if films is None and not self._shown:
            where = self._folder or "The capture's folder"
            names = ", ".join(camera.name for camera in cameras_of(obj)[:3])
            nothing = f"{where}: found no clips of {obj.name}, expected videos or images of {names}, ..."
            raise _NoClipsError(self._problem if self._folder and self._problem else nothing)
        if self._problem:
            self.report({"WARNING"}, f"The original clips are shown: {self._problem}")
        return self._write(films, obj.session_uid), films.total if films is not None else 0

    def _write(self, films: Undistortion | None, capture: int) -> Steps:
        """Write the clips, then show them if the capture still exists."""
        if films is None:
            return
        yield from films.steps
        obj = find_by_uid(bpy.data.objects, capture)
        if obj is not None:
            self._show(obj, straight=True)

    def _show(self, obj: bpy.types.Object, *, straight: bool) -> None:
        self._shown = add_clips(obj, self._folder, in_front=self._in_front, straight=straight)

    def finished_message(self) -> str:
        said = f"Showing the clips of {self._shown} camera{'s' * (self._shown != 1)}.{self._hint}"
        return "" if self._problem else said

    def stopped_message(self) -> str:
        return f"No clips were written.{' The original clips are shown.' if self._shown else ''}"

    def failed_message(self, reason: str) -> str:
        return f"The original clips are shown: {reason}" if self._shown else reason


def _is_covered(context: bpy.types.Context) -> bool:
    """Whether splats cover what is behind the scene in the viewport of a context."""
    space = context.space_data
    is_viewport = space is not None and space.type == "VIEW_3D"
    return is_viewport and (space.shading.type == "RENDERED" or drawing.is_wanted(context.scene))


class FROG_OT_hide_clips(_OfCameras, UndoableOperator, bpy.types.Operator):
    """Hide the videos behind the capture's cameras"""

    bl_label = "Hide Clips"

    def act(self, context: bpy.types.Context) -> None:
        for camera in cameras_of(active_capture(context)):
            hide_clip(camera)


def register() -> None:
    refresh_drivers()
