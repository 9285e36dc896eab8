"""File > Import > FRoG scene, and dropping a .frog file into the viewport; and what all importers have in common."""

# mypy: disable-error-code="valid-type"

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import bpy
from bpy.props import CollectionProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..engine.errors import FrogError
from ..properties import number, switch
from ..scene_import.capture_objects import select_capture
from ..scene_import.create_objects import import_scene
from ..scene_import.scene_setup import is_untouched
from ..timeline.retiming import other_rate
from ..viewport import views
from .bases import UndoableOperator, scene_of


class ImportsFiles(UndoableOperator, ImportHelper):
    """Base of importers: a dropped file needs no file browser, several can be selected, and two properties decide what
    else of the scene changes.

    Left alone these are on where the scene holds nothing of the user's, else off. They are not remembered from one
    import to the next, because the next scene is another.
    """

    # Blender fills them with what was dropped or chosen; its ``invoke_popup`` asks for ``files``.
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    set_up_scene: switch(
        "Set Up Scene",
        "Use the capture's frame range, frame rate, image size, camera and background, and show its "
        "colours unchanged (Standard view transform, no dithering). Enabled by default in a new file only",
        True,
        options={"SKIP_SAVE"},
    )
    use_frog_engine: switch(
        "Render with FRoG",
        "Make FRoG the scene's render engine, which draws the captures as they were trained, and show "
        "rendered viewports. Enabled by default in a new file only",
        True,
        options={"SKIP_SAVE"},
    )

    _decided: Mapping[str, bool] = MappingProxyType({})
    """What ``decide`` has set."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Shows the properties with this scene's defaults."""
        self.decide(context.scene)
        if self.filepath and Path(self.filepath).is_file():
            return self.invoke_popup(context)
        return super().invoke(context, event)

    def paths(self) -> list[Path]:
        """All files that were dropped, selected or named."""
        folder = Path(bpy.path.abspath(self.directory))
        several = [folder / file.name for file in self.files if file.name]
        return several if len(several) > 1 else [Path(bpy.path.abspath(self.filepath))]

    def decide(self: Any, scene: bpy.types.Scene) -> bool:
        """Sets both properties, unless they were given. Returns whether the settings stay unchanged by default."""
        given, untouched = self.properties.is_property_set, is_untouched(scene)
        left_alone = not given("set_up_scene") and not untouched
        decided = dict(self._decided)
        if not given("set_up_scene"):
            self.set_up_scene = decided["set_up_scene"] = untouched
        if not given("use_frog_engine"):
            self.use_frog_engine = decided["use_frog_engine"] = untouched or self.set_up_scene
        self._decided = decided
        return left_alone

    def wanted(self: Any, scene: bpy.types.Scene) -> tuple[bool, bool]:
        """Both properties, long after ``decide``: on only where the user chose so, or where the scene still holds
        nothing of the user's.
        """
        untouched = is_untouched(scene)

        def is_chosen(name: str) -> bool:
            return getattr(self, name) != self._decided.get(name)

        sets_up = self.set_up_scene and (untouched or is_chosen("set_up_scene"))
        return sets_up, self.use_frog_engine and (untouched or sets_up or is_chosen("use_frog_engine"))


class DropsIntoViews:
    """Base of file handlers: files can be dropped into viewports and outliners."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}


class FROG_OT_import_scene(ImportsFiles, bpy.types.Operator):
    """Import a trained FRoG scene: its Gaussians, its cameras and its frame range"""

    bl_idname = "import_scene.frog"
    bl_label = "Import FRoG Scene"
    import_menu = "FRoG Scene (.frog)"

    filename_ext = ".frog"
    start_frame: number("Start Frame", "Frame of the timeline at which the capture's first frame is shown", 1.0)

    def act(self, context: bpy.types.Context) -> str:
        """Opens every file; one that cannot be opened does not stop the others. The first one sets up the scene."""
        left_alone, sets_up = self.decide(context.scene), self.set_up_scene
        paths, errors = self.paths(), []
        for path in paths:
            try:
                self._open(context, path, sets_up)
                sets_up = False
            except FrogError as error:
                errors.append(error)
        views.count_as_untouched()
        if len(errors) == len(paths):
            raise FrogError("\n".join(map(str, errors)))
        for problem in errors:
            self.report({"ERROR"}, str(problem))
        if not left_alone:
            return ""
        return "The scene's settings were not changed. Use Set Up Scene in the FRoG tab to apply the capture's."

    def _open(self, context: bpy.types.Context, path: Path, sets_up: bool) -> None:
        chosen = {"start_frame": self.start_frame, "use_frog_engine": self.use_frog_engine}
        point_cloud = import_scene(path, context.scene, set_up_scene=sets_up, **chosen)
        select_capture(context, point_cloud)
        if advice := other_rate(context.scene, scene_of(point_cloud).header):
            self.report({"INFO"}, f"{path.name}: {advice}")


class FROG_FH_scene(DropsIntoViews, bpy.types.FileHandler):
    """Lets a .frog file be dropped into a window."""

    bl_label = "FRoG Scene"
    bl_import_operator = "import_scene.frog"
    bl_file_extensions = ".frog"
