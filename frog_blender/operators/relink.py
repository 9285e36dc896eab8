"""Find Scene File: for .frog files that were moved or renamed."""

# mypy: disable-error-code="valid-type"

from contextlib import suppress
from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

from ..engine.errors import FrogError
from ..properties import switch
from ..relative_paths import library_of
from ..scene_import.capture_objects import stored_path
from ..timeline import playback
from .bases import OnCapture, UndoableOperator


def relink(obj: bpy.types.Object, path: Path, *, also_others: bool) -> list[bpy.types.Object]:
    """Makes an object of this .blend play ``path``. Returns all objects whose file was found.

    With ``also_others`` every capture of this .blend whose file is missing plays the file of the same name in the
    same folder, if there is one; it does so in all objects that play the missing file.  Raises FrogError, and changes
    nothing, if ``path`` cannot be played.
    """
    library = library_of(obj)
    if library is not None:
        raise FrogError(f"{obj.name}: it is linked from {bpy.path.abspath(library.filepath)}. Find its file there.")
    playback.open_scene(path)
    lost, changes = playback.file_of(obj), {obj: path}
    for other in playback.captures(bpy.data.objects) if also_others else ():
        file = playback.file_of(other)
        if other == obj or library_of(other) is not None or file.is_file():
            continue
        there = path if file == lost else path.parent / file.name
        if there.is_file():
            with suppress(FrogError):  # what cannot be played is no find
                playback.open_scene(there)
                changes[other] = there
    for capture, file in changes.items():
        capture.frog.filepath = stored_path(file)
    return list(changes)


class FROG_OT_relink(OnCapture, UndoableOperator, ImportHelper, bpy.types.Operator):
    """Choose the current location of this capture's .frog file"""

    bl_label = "Find Scene File"

    filename_ext = ".frog"
    all_missing: switch(
        "All Missing Captures",
        "Also search this folder for the files of all other missing captures, by file name",
        True,
    )

    def act(self, context: bpy.types.Context) -> str:
        path = Path(bpy.path.abspath(self.filepath))
        relinked = relink(self.capture(context), path, also_others=self.all_missing)
        for scene in bpy.data.scenes:
            playback.refresh(scene)
        missing = [other.name for other in playback.captures(bpy.data.objects) if not playback.file_of(other).is_file()]
        said = f"Found the file of {relinked[0].name}."
        if len(relinked) > 1:
            said = f"Found the files of {len(relinked)} captures."
        return f"{said} Still missing: {', '.join(missing)}." if missing else said
