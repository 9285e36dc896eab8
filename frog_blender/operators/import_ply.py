"""File > Import > Splats, and dropping another program's Gaussians into the viewport: a capture that plays them."""

# mypy: disable-error-code="valid-type"

from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty
from mathutils import Matrix

from ..engine.errors import FrogError
from ..engine.interchange.imports import SUFFIXES, says_what_is_up
from ..engine.playback.transform import Y_DOWN
from ..scene_import.capture_objects import root_of, select_capture
from ..scene_import.create_objects import import_scene
from .file_drop import DropsIntoViews, OpensDroppedFile
from .foreign_formats import expose_usd, told_progress
from .set_up_scene import SetsUpScene


class FROG_OT_import_splats(SetsUpScene, OpensDroppedFile, bpy.types.Operator):
    """Import another program's Gaussians as a capture: one time of them, or a sequence that plays. They are converted \
to a .frog file"""

    bl_idname = "import_scene.frog_splats"
    bl_label = "Import 3DGS Splats"
    bl_options = {"REGISTER", "UNDO"}

    filename_ext = ".ply"
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
    turn_upright: BoolProperty(
        name="Y Down to Z Up",
        description="Rotate the capture's empty: in most 3DGS files y points down, in Blender z points up. USD files "
        "say themselves what is up",
        default=True,
    )
    scene_file: StringProperty(
        name="Scene File",
        description="The .frog file to write. If empty, or if several files are imported, it is written next to "
        "each file under the same name, with a number if that name is taken",
        subtype="FILE_PATH",
    )
    sequence: BoolProperty(
        name="Sequence",
        description="Import all .ply files of the folder as frames, in the order of the numbers in their names, at the "
        "scene's frame rate",
        default=False,
    )
    compact: BoolProperty(
        name="Pack",
        description="Make the .frog file several times smaller. The changes are too small to see",
        default=False,
    )

    def paths(self) -> list[Path]:
        """Of a sequence's frames one, as that imports all of their folder."""
        found: dict[Path, Path] = {}
        for path in super().paths():
            is_frame = self.sequence and path.suffix.lower() == ".ply"
            found.setdefault(path.parent if is_frame else path, path)
        return list(found.values())

    def open_file(self, context: bpy.types.Context) -> set[str]:
        from ..engine.interchange.imports import free_scene_path
        from ..engine.interchange.imports import import_scene as import_file

        source = Path(bpy.path.abspath(self.filepath))
        if self.sequence and source.suffix.lower() == ".ply":
            source = source.parent
        rate = context.scene.render.fps / context.scene.render.fps_base
        self.decide(context.scene)
        try:
            is_alone = len(self.paths()) < 2
            named = Path(bpy.path.abspath(self.scene_file)) if self.scene_file and is_alone else None
            with told_progress(context) as progress:
                expose_usd()
                target = named or free_scene_path(source)
                imported = import_file(source, target, compact=self.compact, rate=rate, progress=progress)
            obj = import_scene(
                imported.path,
                context.scene,
                set_up_scene=self.set_up_scene,
                use_frog_engine=self.use_frog_engine,
            )
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if self.turn_upright and not says_what_is_up(source):
            root = root_of(obj)
            root.matrix_basis = Matrix(Y_DOWN.T.tolist()) @ root.matrix_basis
        select_capture(context, obj)
        if imported.warning:
            self.report({"WARNING"}, imported.warning)
        else:
            frames = f" in {imported.frames:,} frames" if imported.frames > 1 else ""
            self.report({"INFO"}, f"Imported {imported.gaussians:,} Gaussians{frames} to {imported.path}.")
        return {"FINISHED"}


class FROG_FH_splats(DropsIntoViews, bpy.types.FileHandler):
    """Lets such files be dropped into a viewport; Blender asks whether to use its own importer or this one."""

    bl_idname = "FROG_FH_splats"
    bl_label = "3DGS Splats (FRoG)"
    bl_import_operator = "import_scene.frog_splats"
    bl_file_extensions = ";".join(SUFFIXES)


def _menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.operator(FROG_OT_import_splats.bl_idname, text="Splats (.ply, .spz, .glb, .splat, .usd, .4dgs)")


_CLASSES = (FROG_OT_import_splats, FROG_FH_splats)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    _unregister_classes()
