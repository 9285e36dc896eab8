"""File > Export > FRoG as USD and as Web Page: a capture as one file that plays in other programs."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..capture_files import file_of, named_file
from ..engine.errors import FrogError
from ..scene_import.capture_objects import active_capture
from ..scene_import.capture_sound import has_sound
from ..timeline.frame_timing import frames_shown
from .foreign_formats import require_usd
from .modal_operator import ModalOperator
from .timeline_take import TimelineTake

if TYPE_CHECKING:
    from ..engine.interchange.take import Sound

RANGES = (
    ("SCENE", "Scene Range", "The frames of the scene's frame range"),
    ("CUSTOM", "Custom Range", "The frames of a range"),
    ("CURRENT", "Current Frame", "The current frame alone"),
)


class ExportsTake(ModalOperator, ExportHelper):
    """Writes the frames of the timeline to one file; classes say how."""

    filepath: StringProperty(subtype="FILE_PATH")

    frames: EnumProperty(name="Frames", description="Frames of the timeline to write", items=RANGES, default="SCENE")
    first: IntProperty(name="First", description="First frame of the timeline to write", default=1)
    last: IntProperty(name="Last", description="Last frame of the timeline to write", default=250)
    apply_transform: BoolProperty(
        name="Apply Transform",
        description="Write where the capture's empty stands, as it is animated. Otherwise the Gaussians are written in "
        "the capture's own coordinates",
        default=True,
    )
    use_sound: BoolProperty(
        name="Sound",
        description="Write the sound of the capture's videos, if one of them can be found that has any",
        default=True,
    )

    doing = "Exporting {done:,} of {total:,} frames"
    is_interactive = False  # by a user, in the file browser
    is_placed = True  # it matters where the capture stands
    _take: TimelineTake | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("Import or select a FRoG capture first.")
        return active_capture(context) is not None

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            self.filepath = str(named_file(active_capture(context)).with_suffix(self.filename_ext))
        self.is_interactive = True
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(self, "frames")
        if self.frames == "CUSTOM":
            layout.prop(self, "first")
            layout.prop(self, "last")
        if self.is_placed:
            layout.prop(self, "apply_transform")
        layout.prop(self, "use_sound")

    def execute(self, context: bpy.types.Context) -> set[str]:
        in_steps, self.is_interactive = self.is_interactive, False  # a repeated operator runs to its end
        obj, path = active_capture(context), Path(bpy.path.abspath(self.filepath))
        numbers = self._numbers(context.scene)
        if obj is None or not numbers:
            found = f"The range is empty: it starts at frame {self.first} and ends at frame {self.last}."
            self.report({"ERROR"}, found if obj is not None else "No capture is selected. Import or select one first.")
            return {"CANCELLED"}
        try:
            take = self._take = TimelineTake.of(context, obj, numbers, placed=self.is_placed and self.apply_transform)
            if self.use_sound:
                take.sound = _sound(obj, context.scene, take)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        steps = self.written(path, take)
        if in_steps and len(numbers) > 1 and self.has_window(context):
            return self.run_in_window(context, steps, len(numbers))
        return self.run_all_steps(context, steps, len(numbers))

    def written(self, path: Path, take: TimelineTake) -> Generator[int, None, None]:
        """Writes the take; yields how many frames are done, and raises FrogError."""
        raise NotImplementedError

    def finished_message(self) -> str:
        return f"{self._total:,} {'frame' if self._total == 1 else 'frames'} written to {self._file}."

    def stopped_message(self) -> str:
        return f"The export was stopped. {self._file} was not written."

    def failed_message(self, reason: str) -> str:
        return reason

    def restore(self) -> None:
        if self._take is not None:
            self._take.restore()

    @property
    def _file(self) -> Path:
        return Path(bpy.path.abspath(self.filepath))

    def _numbers(self, scene: bpy.types.Scene) -> list[float]:
        if self.frames == "CURRENT":
            return [float(scene.frame_current)]
        first, last = (self.first, self.last) if self.frames == "CUSTOM" else (scene.frame_start, scene.frame_end)
        return [float(frame) for frame in range(first, last + 1)]


def _sound(obj: bpy.types.Object, scene: bpy.types.Scene, take: TimelineTake) -> Sound | None:
    """What is heard with a take; None for silence."""
    from ..engine.interchange.take import sound_of

    shown = frames_shown(obj, scene, [int(number) for number in take.numbers])
    return sound_of(take.header, file_of(obj), shown, take.rate, has_sound)


class FROG_OT_export_usd(ExportsTake, bpy.types.Operator):
    """Write a capture as animated USD, which Blender from 5.3 on and other programs play without FRoG. Press Esc or \
the right mouse button to stop"""

    bl_idname = "export_scene.frog_usd"
    bl_label = "Export FRoG as USD"
    bl_options = {"REGISTER"}

    filename_ext = ".usdc"
    filter_glob: StringProperty(default="*.usdc;*.usda;*.usd", options={"HIDDEN"})
    full_precision: BoolProperty(
        name="Single Precision",
        description="Write single precision. Half precision, but for locations, makes the file almost half as large",
        default=False,
    )

    def draw(self, context: bpy.types.Context) -> None:
        super().draw(context)
        self.layout.prop(self, "full_precision")

    def written(self, path: Path, take: TimelineTake) -> Generator[int, None, None]:
        from ..engine.interchange.usd_export import write_usd

        require_usd()
        yield from write_usd(path, take, full_precision=self.full_precision)


class FROG_OT_export_web_page(ExportsTake, bpy.types.Operator):
    """Write a capture as one web page that plays it in any browser, with sound and without a network. Press Esc or \
the right mouse button to stop"""

    bl_idname = "export_scene.frog_web_page"
    bl_label = "Export FRoG as Web Page"
    bl_options = {"REGISTER"}

    filename_ext = ".html"
    is_placed = False
    filter_glob: StringProperty(default="*.html", options={"HIDDEN"})

    def written(self, path: Path, take: TimelineTake) -> Generator[int, None, None]:
        from ..engine.interchange.web_page.page import write_page

        return write_page(path, take)


def _menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.operator(FROG_OT_export_usd.bl_idname, text="FRoG as USD (.usdc)")
    self.layout.operator(FROG_OT_export_web_page.bl_idname, text="FRoG as Web Page (.html)")


_CLASSES = (FROG_OT_export_usd, FROG_OT_export_web_page)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.TOPBAR_MT_file_export.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_export.remove(_menu)
    _unregister_classes()
