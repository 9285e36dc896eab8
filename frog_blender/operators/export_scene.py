"""File > Export: what the timeline plays of a capture, for other programs.

Each frame becomes a file of its own (.ply, .sog, .spz, .glb), or all become one that plays: USD, or a web page.
"""

# mypy: disable-error-code="valid-type"

from importlib.util import find_spec
from pathlib import Path

import bpy
import numpy as np
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ..capture_files import file_of
from ..engine.errors import FrogError
from ..engine.gaussians import GaussianArrays
from ..engine.interchange.frame_files import AS_THEY_ARE, ending, numbered, write_frame
from ..engine.interchange.spz import Spz
from ..engine.interchange.take import Take, with_sound
from ..engine.interchange.usd_export import rate_to_set, write_usd
from ..engine.interchange.web_page.page import write_page
from ..engine.playback.transform import Y_DOWN, transform
from ..properties import choice, switch, whole
from ..scene_import.capture_objects import active_capture
from ..scene_import.capture_sound import has_sound
from ..timeline import playback
from ..timeline.retiming import raw_frame, stretched
from ..ui.sidebar_panel import split
from .bases import CaptureFileOperator
from .modal_operator import Steps
from .timeline_visit import TimelineVisit, VisitsTimeline, timeline_take

FORMATS = (
    (".ply", "3DGS (.ply)", "What every splat program opens"),
    (".compressed.ply", "Compressed 3DGS (.compressed.ply)", "A quarter as large"),
    (".sog", "SOG (.sog)", "For the web. The smallest"),
    (".spz", "SPZ (.spz)", "A fifth as large. Blender reads it from 5.3 on"),
    (".glb", "glTF (.glb)", "glTF with KHR_gaussian_splatting"),
)
RANGES = (
    ("CURRENT", "Current Frame", "The current frame alone"),
    ("SCENE", "Scene Range", "The frames of the scene's frame range"),
    ("CUSTOM", "Custom Range", "The frames of a range"),
)


class _ExportsTimeline(CaptureFileOperator, VisitsTimeline, ExportHelper):
    """Base of those that write frames of the timeline; classes say how."""

    frames: choice("Frames", "Frames of the timeline to write", RANGES, "SCENE")
    first: whole("First", "First frame of the timeline to write", 1)
    last: whole("Last", "Last frame of the timeline to write", 250)
    apply_transform: switch(
        "Apply Transform",
        "Write where the capture's empty stands. Otherwise the Gaussians are written in the capture's own coordinates",
        True,
    )

    bl_options = {"REGISTER"}
    doing = "Exporting {done:,} of {total:,} frames"
    is_placed = True  # it matters where the capture stands

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.is_interactive = True
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    def draw(self, _context: bpy.types.Context) -> None:
        layout = split(self.layout)
        layout.prop(self, "frames")
        if self.frames == "CUSTOM":
            layout.prop(self, "first")
            layout.prop(self, "last")
        if self.is_placed:
            layout.prop(self, "apply_transform")

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        obj, scene = active_capture(context), context.scene
        if obj is None:
            raise FrogError("No capture is selected. Import or select one first.")
        first, last = (self.first, self.last) if self.frames == "CUSTOM" else (scene.frame_start, scene.frame_end)
        frames = [raw_frame(scene)] if self.frames == "CURRENT" else [*map(float, range(first, last + 1))]
        if not frames:
            raise FrogError(f"The range is empty: it starts at frame {first} and ends at frame {last}.")
        return self.written(self.visiting(context, obj), frames), len(frames)

    def written(self, visit: TimelineVisit, frames: list[float]) -> Steps:
        """Writes frames of a capture; raises FrogError."""
        raise NotImplementedError


class FROG_OT_export_frames(_ExportsTimeline, bpy.types.Operator):
    """Write the Gaussians of a capture, frame by frame, as files that other splat programs can open. Press \
Esc or the right mouse button to stop"""

    bl_idname = "export_scene.frog_frames"
    bl_label = "Export FRoG Frames"
    export_menu = "FRoG Frames (.ply, .sog, .spz, .glb)"

    filename_ext = ".ply"
    filter_glob: StringProperty(default="*.ply;*.sog;*.spz;*.glb", options={"HIDDEN"})
    frames: choice("Frames", "Frames of the timeline to write", RANGES)
    file_format: choice("Format", "Kind of files to write", FORMATS, ".ply")
    y_down: switch(
        "Y Down",
        "Convert Blender's axes (z up) to those of most 3DGS files (y down), so that the Gaussians are "
        "upright in other programs and return to their place when they are imported here again",
        True,
    )
    spz_version: choice(
        "Version",
        "Version of .spz files",
        (
            ("2", "2", "Most programs read it"),
            ("3", "3", "Closer turns. Fewer programs read it"),
            ("4", "4", "As 3, packed by zstd. Fewest programs read it"),
        ),
    )
    spz_coarse: switch("Coarse", "Write the precision of other programs: half as large")

    def draw(self, context: bpy.types.Context) -> None:
        layout = split(self.layout)
        layout.prop(self, "file_format")
        if self.file_format == ".spz":
            layout.prop(self, "spz_version")
            layout.prop(self, "spz_coarse")
        super().draw(context)
        row = layout.row()
        row.enabled = self.apply_transform and self.file_format in AS_THEY_ARE
        row.prop(self, "y_down")

    def check(self, _context: bpy.types.Context) -> bool:
        """Names the file as its format, so that the browser shows which one would be replaced."""
        name = bpy.path.basename(self.filepath)
        if name:
            self.filepath = self.filepath.removesuffix(ending(Path(name))) + self.file_format
        return bool(name)

    def written(self, visit: TimelineVisit, frames: list[float]) -> Steps:
        self.check(bpy.context)
        to_y_down = self.y_down and self.file_format in AS_THEY_ARE  # the others say themselves which way is up
        turn = (Y_DOWN if to_y_down else np.eye(4)) if self.apply_transform else None
        promise = len(frames) > 1 and playback.open_scene(file_of(visit.found()[0])).keeps_identity
        several, spz = self.frames != "CURRENT", Spz(int(self.spz_version), self.spz_coarse)
        for done, frame in enumerate(frames, 1):
            file = numbered(self.path, int(frame)) if several else self.path
            write_frame(file, _gaussians(visit, frame, turn), promise=promise, spz=spz)
            yield done

    def finished_message(self) -> str:
        return f"{self._done:,} {'file' if self._done == 1 else 'files'} written to {self.path.parent}."

    def stopped_message(self) -> str:
        return f"The export was stopped. {self._done:,} of {self._total:,} files were written to {self.path.parent}."

    def failed_message(self, reason: str) -> str:
        if not self._done:
            return reason
        return f"{reason.rstrip('.')}; {self._done:,} of {self._total:,} files were written to {self.path.parent}."


def _gaussians(visit: TimelineVisit, frame: float, turn: np.ndarray | None) -> GaussianArrays:
    """Of a frame, placed and turned to the axes of the files; in the capture's own space, which mostly needs no other
    frame to be shown, if nothing turns them.
    """
    obj, scene = visit.found()
    if turn is None and not playback.needs_evaluation(obj):
        return playback.scene_time(obj, stretched(scene, frame)).gaussians()
    shown = visit.at(frame, placed=True)
    if turn is None or shown.placement is None:
        return shown.gaussians
    try:
        return transform(shown.gaussians, turn @ shown.placement)
    except FrogError as error:
        reason = str(error).rstrip(".")
        raise FrogError(f"{obj.name}: {reason}, or be exported without Apply Transform.") from error


class _ExportsTake(_ExportsTimeline):
    """Base of those that write the frames to one file that plays."""

    use_sound: switch(
        "Sound", "Write the sound of the capture's videos, if one of them can be found that has any", True
    )
    advice = ""

    def draw(self, context: bpy.types.Context) -> None:
        super().draw(context)
        self.layout.prop(self, "use_sound")

    def written(self, visit: TimelineVisit, frames: list[float]) -> Steps:
        take = timeline_take(visit, frames, placed=self.is_placed and self.apply_transform)
        return self.take_written(with_sound(take, file_of(visit.found()[0]), has_sound) if self.use_sound else take)

    def take_written(self, take: Take) -> Steps:
        """Writes the take; raises FrogError."""
        raise NotImplementedError

    def finished_message(self) -> str:
        written = f"{self._total:,} {'frame' if self._total == 1 else 'frames'} written to {self.path}."
        return f"{written} {self.advice}".rstrip()

    def stopped_message(self) -> str:
        return f"The export was stopped. {self.path} was not written."


class FROG_OT_export_usd(_ExportsTake, bpy.types.Operator):
    """Write a capture as animated USD, which Blender from 5.3 on and other programs play without FRoG. Press Esc or \
the right mouse button to stop"""

    bl_idname = "export_scene.frog_usd"
    bl_label = "Export FRoG as USD"
    export_menu = "FRoG as USD (.usdc)"

    filename_ext = ".usdc"
    filter_glob: StringProperty(default="*.usdc;*.usda;*.usd", options={"HIDDEN"})
    full_precision: switch(
        "Single Precision",
        "Write single precision. Half precision, but for locations, makes the file almost half as large",
    )

    def draw(self, context: bpy.types.Context) -> None:
        super().draw(context)
        self.layout.prop(self, "full_precision")

    def take_written(self, take: Take) -> Steps:
        bpy.utils.expose_bundled_modules()  # Blender's own USD library, which the builds of Linux distributions lack
        if find_spec("pxr") is None:
            raise FrogError("This Blender's Python has no USD library (pxr); Blender from blender.org has one.")
        self.advice = rate_to_set(take)
        return write_usd(self.path, take, full_precision=self.full_precision)


class FROG_OT_export_web_page(_ExportsTake, bpy.types.Operator):
    """Write a capture as one web page that plays it in any browser, with sound and without a network. Press Esc or \
the right mouse button to stop"""

    bl_idname = "export_scene.frog_web_page"
    bl_label = "Export FRoG as Web Page"
    export_menu = "FRoG as Web Page (.html)"

    filename_ext = ".html"
    is_placed = False

    def take_written(self, take: Take) -> Steps:
        return write_page(self.path, take)
