"""File > Import > FRoG scene, and dropping a .frog file into the viewport."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..engine.errors import FrogError
from ..scene_import.camera_clips import clip_of
from ..scene_import.capture_objects import cameras_of, select_capture
from ..scene_import.create_objects import import_scene
from .file_drop import DropsIntoViews, OpensDroppedFile
from .set_up_scene import SetsUpScene


class FROG_OT_import_scene(SetsUpScene, OpensDroppedFile, bpy.types.Operator):
    """Import a trained FRoG scene: its Gaussians, its cameras and its frame range"""

    bl_idname = "import_scene.frog"
    bl_label = "Import FRoG Scene"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".frog"
    filter_glob: StringProperty(default="*.frog", options={"HIDDEN"})
    start_frame: FloatProperty(
        name="Start Frame",
        description="Frame of the timeline at which the capture's first frame is shown",
        default=1.0,
    )
    show_clips: BoolProperty(
        name="Clips",
        description="Show each camera's video as its background, if the videos can be found. For lenses with "
        "distortion, use Show Clips in the FRoG tab",
        default=True,
    )

    def open_file(self, context: bpy.types.Context) -> set[str]:
        path = Path(bpy.path.abspath(self.filepath))
        left_alone = self.decide(context.scene)
        try:
            point_cloud = import_scene(
                path,
                context.scene,
                start_frame=self.start_frame,
                set_up_scene=self.set_up_scene,
                use_frog_engine=self.use_frog_engine,
                show_clips=self.show_clips,
            )
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        select_capture(context, point_cloud)
        cameras = cameras_of(point_cloud)
        if self.show_clips and cameras and not any(clip_of(camera) for camera in cameras):
            self.report({"INFO"}, "The capture's videos were not found. Use Show Clips in the FRoG tab to locate them.")
        if left_alone:
            self.report(
                {"INFO"},
                "The scene's settings were not changed. Use Set Up Scene in the FRoG tab to apply the capture's.",
            )
        return {"FINISHED"}


class FROG_FH_scene(DropsIntoViews, bpy.types.FileHandler):
    """Lets a .frog file be dropped into a window."""

    bl_idname = "FROG_FH_scene"
    bl_label = "FRoG Scene"
    bl_import_operator = "import_scene.frog"
    bl_file_extensions = ".frog"


def _menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.operator(FROG_OT_import_scene.bl_idname, text="FRoG Scene (.frog)")


_CLASSES = (FROG_OT_import_scene, FROG_FH_scene)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    _unregister_classes()
