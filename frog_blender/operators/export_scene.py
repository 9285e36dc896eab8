"""File > Export: frames of a capture as 3DGS .ply files, and a copy of its .frog file."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..capture_files import named_file
from ..engine.errors import FrogError
from ..engine.playback.transform import Y_DOWN
from ..scene_import.capture_objects import active_capture, stored_path
from ..timeline import playback
from ..timeline.retiming import raw_frame
from .frame_export import FrameExport
from .modal_operator import ModalOperator

FORMATS = (
    (".ply", "3DGS (.ply)", "What every splat program opens"),
    (".spz", "SPZ (.spz)", "Ten times smaller. Blender reads it from 5.3 on"),
    (".glb", "glTF (.glb)", "glTF with KHR_gaussian_splatting"),
)
RANGES = (
    ("CURRENT", "Current Frame", "One file, of the current frame"),
    ("SCENE", "Scene Range", "One file for each frame of the scene's frame range"),
    ("CUSTOM", "Custom Range", "One file for each frame of a range"),
)


class FROG_OT_export_frames(ModalOperator, bpy.types.Operator, ExportHelper):
    """Write the Gaussians of a capture, frame by frame, as files that other splat programs can open. Press \
Esc or the right mouse button to stop"""

    bl_idname = "export_scene.frog_frames"
    bl_label = "Export FRoG Frames"
    bl_options = {"REGISTER"}

    filename_ext = ".ply"
    filter_glob: StringProperty(default="*.ply;*.spz;*.glb", options={"HIDDEN"})
    file_format: EnumProperty(name="Format", description="Kind of files to write", items=FORMATS, default=".ply")
    frames: EnumProperty(name="Frames", description="Frames of the timeline to write", items=RANGES, default="CURRENT")
    first: IntProperty(name="First", description="First frame of the timeline to write", default=1)
    last: IntProperty(name="Last", description="Last frame of the timeline to write", default=250)
    apply_transform: BoolProperty(
        name="Apply Transform",
        description="Apply the location, rotation and scale of the capture's empty to the Gaussians. Otherwise they "
        "are written in the capture's own coordinates",
        default=True,
    )
    y_down: BoolProperty(
        name="Y Down",
        description="Convert Blender's axes (z up) to those of most 3DGS files (y down), so that the Gaussians are "
        "upright in other programs and return to their place when they are imported here again",
        default=True,
    )

    spz_version: EnumProperty(
        name="Version",
        description="Version of .spz files",
        items=(
            ("3", "3", "Every program that knows the format reads it"),
            ("4", "4", "Smaller. Blender reads and writes it from 5.3 on"),
        ),
        default="3",
    )

    doing = "Exporting {done:,} of {total:,} frames"
    is_interactive = False  # by a user, in the file browser
    _export: FrameExport | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Import or select a FRoG capture first.")
        return active_capture(context) is not None

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        _suggest(self, context)
        self.is_interactive = True
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(self, "file_format")
        if self.file_format == ".spz":
            layout.prop(self, "spz_version")
        layout.prop(self, "frames")
        if self.frames == "CUSTOM":
            layout.prop(self, "first")
            layout.prop(self, "last")
        layout.prop(self, "apply_transform")
        row = layout.row()
        row.enabled = self.apply_transform and self.file_format == ".ply"
        row.prop(self, "y_down")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Several frames chosen in the file browser are written one by one while Blender stays responsive."""
        from ..engine.interchange.frame_files import numbered

        in_steps, self.is_interactive = self.is_interactive, False  # a repeated operator runs to its end
        obj, path = active_capture(context), Path(bpy.path.abspath(self.filepath))
        frames = self._frames(context.scene)
        if obj is None:
            self.report({"ERROR"}, "No capture is selected. Import or select one first.")
            return {"CANCELLED"}
        if not frames:
            self.report(
                {"ERROR"}, f"The range is empty: it starts at frame {self.first} and ends at frame {self.last}."
            )
            return {"CANCELLED"}
        if self.file_format != ".ply":
            path = path.with_suffix(self.file_format)
        paths = [path if self.frames == "CURRENT" else numbered(path, int(frame)) for frame in frames]
        to_y_down = self.y_down and self.file_format == ".ply"  # the others say themselves which way is up
        turn = (Y_DOWN if to_y_down else np.eye(4)) if self.apply_transform else None
        export = self._export = FrameExport.of(context, obj, frames, paths, turn)
        export.spz_version = int(self.spz_version)
        if in_steps and len(frames) > 1 and self.has_window(context):
            return self.run_in_window(context, export.steps(), len(frames))
        return self.run_all_steps(context, export.steps(), len(frames))

    def finished_message(self) -> str:
        return f"{self._done:,} {'file' if self._done == 1 else 'files'} written to {self._folder}."

    def stopped_message(self) -> str:
        return f"The export was stopped. {self._done:,} of {self._total:,} files were written to {self._folder}."

    def failed_message(self, reason: str) -> str:
        if not self._done:
            return reason
        return f"{reason.rstrip('.')}; {self._done:,} of {self._total:,} files were written to {self._folder}."

    def restore(self) -> None:
        if self._export is not None:
            self._export.restore()

    @property
    def _folder(self) -> Path:
        return Path(bpy.path.abspath(self.filepath)).parent

    def _frames(self, scene: bpy.types.Scene) -> list[float]:
        if self.frames == "CURRENT":
            return [raw_frame(scene)]
        first, last = (self.first, self.last) if self.frames == "CUSTOM" else (scene.frame_start, scene.frame_end)
        return [float(frame) for frame in range(first, last + 1)]


class FROG_OT_export_scene(bpy.types.Operator, ExportHelper):
    """Copy the capture's .frog file to another location"""

    bl_idname = "export_scene.frog"
    bl_label = "Export FRoG Scene"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".frog"
    filter_glob: StringProperty(default="*.frog", options={"HIDDEN"})
    use_copy: BoolProperty(
        name="Play the Copy",
        description="Make the capture play the copy instead of its current file",
        default=False,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Import or select a FRoG capture first.")
        return active_capture(context) is not None

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        _suggest(self, context)
        return super().invoke(context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..engine.io.atomic_files import write_atomically

        obj, path = active_capture(context), Path(bpy.path.abspath(self.filepath))
        source = playback.file_of(obj)
        try:
            playback.open_scene(source)  # a damaged file is not copied
            if path.resolve() == source.resolve():
                raise FrogError(f"{path}: {obj.name} already plays this file. Choose another location.")
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
        self.report({"INFO"}, f"Exported {path}.")
        return {"FINISHED"}


def _suggest(operator: bpy.types.Operator, context: bpy.types.Context) -> None:
    """Suggests a path next to the .frog file, with the same name."""
    if not operator.filepath:
        operator.filepath = str(named_file(active_capture(context)).with_suffix(operator.filename_ext))


def _menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.operator(FROG_OT_export_frames.bl_idname, text="FRoG Frames (.ply, .spz, .glb)")
    self.layout.operator(FROG_OT_export_scene.bl_idname, text="FRoG Scene (.frog)")


_CLASSES = (FROG_OT_export_frames, FROG_OT_export_scene)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.TOPBAR_MT_file_export.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_export.remove(_menu)
    _unregister_classes()
