"""File > Import > Splats, and dropping another program's Gaussians into the viewport: a capture that plays them."""

# mypy: disable-error-code="valid-type"

from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path

import bpy
from bpy.props import StringProperty
from mathutils import Matrix

from .. import addon_state, unsaved_changes
from ..engine.errors import FrogError
from ..engine.interchange import imports
from ..engine.interchange.imports import META, SUFFIXES, Imported, says_what_is_up
from ..engine.playback.transform import Y_DOWN
from ..properties import switch, text
from ..scene_import.capture_objects import finder, root_of, select_capture
from ..scene_import.create_objects import import_scene
from ..tasks.foreign_import import ForeignImport, Importing
from ..timeline.retiming import frame_rate, other_rate
from .bases import scene_of
from .import_frog import DropsIntoViews, ImportsFiles
from .modal_operator import BesideUser, Steps

_PARTS = 1000  # steps of the progress of one file
_TURN = "rotate its empty by -90 degrees about the global X axis, around the world's origin"
"""What Y Down to Z Up does."""


class FROG_OT_import_splats(ImportsFiles, BesideUser, bpy.types.Operator):
    """Import another program's Gaussians as a capture: one time of them, or a sequence that plays. They are converted \
to a .frog file"""

    bl_idname = "import_scene.frog_splats"
    bl_label = "Import 3DGS Splats"
    import_menu = "Splats (.ply, .sog, .spz, .glb, .splat, .usd)"

    filename_ext = ".ply"
    filter_glob: StringProperty(default=";".join([*(f"*{suffix}" for suffix in SUFFIXES), META]), options={"HIDDEN"})
    turn_upright: switch(
        "Y Down to Z Up",
        "Rotate the capture's empty: in most 3DGS files y points down, in Blender z points up. USD files "
        "say themselves what is up",
        True,
    )
    scene_file: text(
        "Scene File",
        "The .frog file to write. If empty, or if several files are imported, it is written next to "
        "each file under the same name, with a number if that name is taken",
        subtype="FILE_PATH",
    )
    sequence: switch(
        "Sequence",
        "Import all .ply files of the folder as frames, in the order of the numbers in their names, at the "
        "scene's frame rate",
    )
    compact: switch("Pack", "Make the .frog file several times smaller. The changes are too small to see")

    at_once = 0.5
    _written: Path | None = None  # and not added yet

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        return ForeignImport.busy if ForeignImport.is_busy() else ""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.is_interactive = True
        return super().invoke(context, event)

    def paths(self) -> list[Path]:
        """Of a sequence's frames one, as that imports all of their folder."""
        sources: dict[Path, Path] = {}
        for path in super().paths():
            sources.setdefault(path.parent if self._is_frame(path) else path, path)
        return list(sources.values())

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        """Converts beside the main thread, and adds each capture when it is there. In a window that takes longer than
        a moment the user goes on working meanwhile.
        """
        paths = self.paths()
        self.decide(context.scene)
        bpy.utils.expose_bundled_modules()  # Blender's own USD library, if it has one
        return self._steps_of(context, paths), _PARTS * len(paths)

    def _steps_of(self, context: bpy.types.Context, paths: list[Path]) -> Steps:
        """Imports every file; one that cannot be imported does not stop the others. The first one sets up the scene."""
        find, rate = finder(context.scene), frame_rate(context.scene)
        errors, self.said = [], ""
        if ForeignImport.is_busy():
            raise FrogError(ForeignImport.busy)
        importing = addon_state.get(Importing)
        importing.is_taken = True
        try:
            for index, path in enumerate(paths):
                try:
                    task = ForeignImport(path, self._converter(path, rate, is_alone=len(paths) < 2)).begin()
                    for share in self._until_added(task, find):
                        yield _PARTS * index + round(_PARTS * share)
                except FrogError as error:
                    errors.append(str(error))
        finally:
            importing.is_taken = False
            if (current := ForeignImport.current()) is not None:
                current.cancel()
        for sentence in errors if self.said else errors[:-1]:
            self.report({"ERROR"}, sentence)
        if not self.said:
            raise FrogError(errors[-1])

    def _until_added(
        self, task: ForeignImport, find: Callable[[], bpy.types.Scene | None]
    ) -> Generator[float, None, None]:
        """Converts a file, and adds it once nobody is in the middle of something. Yields the share that is done."""
        importing = f"Importing {task.source.name}".replace("{", "{{").replace("}", "}}")
        while task.is_running:
            share = task.progress.fraction
            self.doing = f"{importing}: {share:.0%}"
            yield share
            self.pump(task)
        if task.result is None:
            raise FrogError(task.error or f"{task.source}: not imported.")
        self._written = task.result.path
        while self.timer is not None and (reason := self._reason_to_wait(find())):
            self.doing = f"{importing}: waiting for {reason}"
            yield 1.0
        self._written = None
        self._add(task.result, task.source, find())

    def _reason_to_wait(self, scene: bpy.types.Scene | None) -> str:
        """What has to end first, as an addition would mix with its undo steps; empty for nothing."""
        if scene is not None and unsaved_changes.is_being_edited(scene):
            return "Object Mode"
        return "the present operation" if unsaved_changes.is_scene_in_use(besides=self) else ""

    def _converter(self, path: Path, rate: float, *, is_alone: bool) -> Callable[..., Imported]:
        """What the worker calls, with the properties as they are now."""
        source = path.parent if self._is_frame(path) else path
        named = Path(bpy.path.abspath(self.scene_file)) if self.scene_file and is_alone else None
        target = named or imports.free_scene_path(source)
        return partial(imports.import_scene, source, target, compact=self.compact, rate=rate)

    def _is_frame(self, path: Path) -> bool:
        """Whether a file stands for the sequence in its folder."""
        return self.sequence and path.suffix.lower() == ".ply"

    def _add(self, imported: Imported, source: Path, scene: bpy.types.Scene | None) -> None:
        """Adds the capture that a file has become; FrogError where that cannot be."""
        context, turns = bpy.context, self.turn_upright and not says_what_is_up(source)
        if scene is None:
            why = "written, but not added, because its scene is not open any more"
            advice = "Import it as a FRoG scene" + (f", and {_TURN}." if turns else ".")
            raise FrogError(f"{imported.path}: {why}. {advice}")
        sets_up, engine = (False, False) if self.has_changed_file else self.wanted(scene)
        obj = import_scene(imported.path, scene, set_up_scene=sets_up, use_frog_engine=engine)
        self.has_changed_file = True
        if turns:
            root = root_of(obj)
            root.matrix_basis = Matrix(Y_DOWN.T.tolist()) @ root.matrix_basis
        if scene == context.scene:
            select_capture(context, obj)
        if imported.warning:
            self.report({"WARNING"}, imported.warning)
        if self.said:
            self.report({"INFO"}, self.said)
        frames = f" in {imported.frames:,} frames" if imported.frames > 1 else ""
        said = f"Imported {imported.gaussians:,} Gaussians{frames} to {imported.path}."
        self.said = f"{said} {other_rate(scene, scene_of(obj).header)}".rstrip()

    def stopped_message(self) -> str:
        written = f"{self._written} is written, but not added." if self._written is not None else ""
        return " ".join(filter(None, ("The import was stopped.", self.said, written)))

    def failed_message(self, reason: str) -> str:
        return f"{self.said} {reason}" if self.said else reason


class FROG_FH_splats(DropsIntoViews, bpy.types.FileHandler):
    """Lets such files be dropped into a viewport; Blender asks whether to use its own importer or this one."""

    bl_label = "3DGS Splats (FRoG)"
    bl_import_operator = "import_scene.frog_splats"
    bl_file_extensions = ";".join(SUFFIXES)
