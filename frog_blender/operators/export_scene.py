"""File > Export: frames of a capture as 3DGS .ply files, and its .frog to another place."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..capture_files import named_file
from ..engine.errors import FrogError
from ..engine.playback.transform import Y_DOWN
from ..scene_import.capture_objects import chosen, stored_path
from ..timeline import playback
from ..timeline.retiming import raw_frame
from .frame_export import FrameExport
from .modal_operator import ModalOperator, has_window

RANGES = (
    ("CURRENT", "Current Frame", "One file, of the moment that is shown now"),
    ("SCENE", "Scene Range", "A file for each frame from the scene's first to its last"),
    ("CUSTOM", "Custom Range", "A file for each frame from one to another"),
)


class FROG_OT_export_frames(ModalOperator, bpy.types.Operator, ExportHelper):
    """Write the Gaussians of frames of a capture as 3DGS .ply files, which other splat programs open. Esc or the \
right mouse button stops it"""

    bl_idname = "export_scene.frog_frames"
    bl_label = "Export FRoG Frames"
    bl_options = {"REGISTER"}

    filename_ext = ".ply"
    filter_glob: StringProperty(default="*.ply", options={"HIDDEN"})
    frames: EnumProperty(
        name="Frames", description="Which frames of the timeline are written", items=RANGES, default="CURRENT"
    )
    first: IntProperty(name="First", description="First frame of the timeline to write", default=1)
    last: IntProperty(name="Last", description="Last frame of the timeline to write", default=250)
    apply_transform: BoolProperty(
        name="Apply Transform",
        description="Write the Gaussians where the capture's empty has moved, turned and scaled them to; otherwise as "
        "they lie in the capture itself, with its own axes",
        default=True,
    )
    y_down: BoolProperty(
        name="Y Down",
        description="Turn Blender's axes (z up) to those of most 3DGS files (y down), so that the Gaussians stand "
        "upright in other programs, and where they stood when they are imported here again",
        default=True,
    )

    doing = "Exporting {done:,} of {total:,} frames"
    is_interactive = False  # by a user, in the file browser
    _export: FrameExport | None = None

    @classmethod
    def poll(cls, context: Any) -> bool:
        cls.poll_message_set("Import or select a FRoG capture first.")
        return chosen(context) is not None

    def invoke(self, context: Any, event: Any) -> set[str]:
        _suggest(self, context)
        self.is_interactive = True
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    def draw(self, _context: Any) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(self, "frames")
        if self.frames == "CUSTOM":
            layout.prop(self, "first")
            layout.prop(self, "last")
        layout.prop(self, "apply_transform")
        row = layout.row()
        row.enabled = self.apply_transform
        row.prop(self, "y_down")

    def execute(self, context: Any) -> set[str]:
        """Several frames that a user asked for in the file browser are written one by one while Blender goes on."""
        from ..engine.interchange.splats import numbered

        asked, self.is_interactive = self.is_interactive, False  # whoever repeats the operator waits for it
        obj, path = chosen(context), Path(bpy.path.abspath(self.filepath))
        frames = self._frames(context.scene)
        if obj is None:
            self.report({"ERROR"}, "No capture is chosen any more; import or select one first.")
            return {"CANCELLED"}
        if not frames:
            self.report({"ERROR"}, f"The range ends at frame {self.last} and begins at {self.first}.")
            return {"CANCELLED"}
        paths = [path if self.frames == "CURRENT" else numbered(path, int(frame)) for frame in frames]
        turn = (Y_DOWN if self.y_down else np.eye(4)) if self.apply_transform else None
        export = self._export = FrameExport.of(context, obj, frames, paths, turn)
        if asked and len(frames) > 1 and has_window(context):
            return self.go_on_in_window(context, export.steps(), len(frames))
        return self.go_through(context, export.steps(), len(frames))

    def finished_sentence(self) -> str:
        return f"{self._done:,} {'file' if self._done == 1 else 'files'} written to {self._folder}."

    def stopped_sentence(self) -> str:
        return f"The export was stopped: {self._done:,} of {self._total:,} files were written to {self._folder}."

    def failed_sentence(self, reason: str) -> str:
        if not self._done:
            return reason
        return f"{reason.rstrip('.')}; {self._done:,} of {self._total:,} files were written to {self._folder}."

    def restore(self) -> None:
        if self._export is not None:
            self._export.restore()

    @property
    def _folder(self) -> Path:
        return Path(bpy.path.abspath(self.filepath)).parent

    def _frames(self, scene: Any) -> list[float]:
        if self.frames == "CURRENT":
            return [raw_frame(scene)]
        first, last = (self.first, self.last) if self.frames == "CUSTOM" else (scene.frame_start, scene.frame_end)
        return [float(frame) for frame in range(first, last + 1)]


class FROG_OT_export_scene(bpy.types.Operator, ExportHelper):
    """Copy the capture's .frog file to a place of your choice"""

    bl_idname = "export_scene.frog"
    bl_label = "Export FRoG Scene"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".frog"
    filter_glob: StringProperty(default="*.frog", options={"HIDDEN"})
    use_copy: BoolProperty(
        name="Play the Copy",
        description="Let the capture play the copy from now on instead of the file that it has",
        default=False,
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        cls.poll_message_set("Import or select a FRoG capture first.")
        return chosen(context) is not None

    def invoke(self, context: Any, event: Any) -> set[str]:
        _suggest(self, context)
        return super().invoke(context, event)

    def execute(self, context: Any) -> set[str]:
        from ..engine.io.atomic_files import write_atomically

        obj, path = chosen(context), Path(bpy.path.abspath(self.filepath))
        source = playback.file_of(obj)
        try:
            playback.open_scene(source)  # a copy of a damaged file would help nobody
            if path.resolve() == source.resolve():
                raise FrogError(f"{path}: this is the file that {obj.name} plays already; choose another place.")
            try:
                content = source.read_bytes()
            except OSError as error:
                raise FrogError(f"{source}: could not be read ({error.strerror or error}).") from error
            write_atomically(path, content)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if self.use_copy:
            obj.frog.filepath = stored_path(path)
        self.report({"INFO"}, f"{path} written.")
        return {"FINISHED"}


def _suggest(operator: Any, context: Any) -> None:
    """Beside the .frog, under its name."""
    if not operator.filepath:
        operator.filepath = str(named_file(chosen(context)).with_suffix(operator.filename_ext))


def _menu(self: Any, _context: Any) -> None:
    self.layout.operator(FROG_OT_export_frames.bl_idname, text="FRoG Frames (.ply)")
    self.layout.operator(FROG_OT_export_scene.bl_idname, text="FRoG Scene (.frog)")


_CLASSES = (FROG_OT_export_frames, FROG_OT_export_scene)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.TOPBAR_MT_file_export.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_export.remove(_menu)
    _unregister_classes()
