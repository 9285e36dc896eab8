"""Save Edits and Load Edits: the edits of a capture as a small JSON file."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper
from mathutils import Matrix

from ..capture_files import named_file
from ..engine.errors import FrogError
from ..scene_import.capture_objects import active_capture
from ..timeline.edits import GRADE, SETTINGS, edits_of, needs_evaluation, store_marks
from ..timeline.frame_timing import timing_of, write_timing
from ..timeline.retiming import is_plain, needs_evaluated_time
from ..timeline.timing_curve import check_editable
from .bases import EditOperator, new_crop, remove_crop, scene_of
from .edit_crops import reset_grade

if TYPE_CHECKING:
    from ..engine.editing.crops import Crop
    from ..engine.editing.edits import Edits
    from ..engine.editing.grades import Grade


class _OfFile(EditOperator):
    """Base, with a helper of Blender's for file browsers, of operators on a file of edits."""

    filename_ext = ".json"
    filepath: StringProperty(subtype="FILE_PATH")
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            path = named_file(active_capture(context))
            self.filepath = str(path.with_name(f"{path.stem}.edits.json"))
        result: set[str] = super().invoke(context, event)  # type: ignore[misc]  # of Blender's helper
        return result

    @property
    def path(self) -> Path:
        """Of the file."""
        return Path(bpy.path.abspath(self.filepath))


class FROG_OT_save_edits(_OfFile, ExportHelper, bpy.types.Operator):
    """Write the edits of the capture as they are at the current frame, and its timing in the scene's frame range, for \
``frog render --edits`` and other files"""

    bl_idname = "frog.save_edits"
    bl_label = "Save Edits"
    bl_options = {"REGISTER"}

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        from ..engine.editing.edits import Edits
        from ..engine.editing.edits_file import save_edits

        is_animated = needs_evaluation(obj, even_unused=True)
        evaluated = obj.evaluated_get(context.evaluated_depsgraph_get()) if is_animated else None
        edits = edits_of(obj, evaluated, even_unused=True) or Edits()
        if not is_plain(obj.frog, context.scene) or needs_evaluated_time(obj):
            edits = replace(edits, timing=timing_of(obj, context.scene))
        save_edits(self.path, edits)
        animated = " as they are at this frame" if evaluated is not None else ""
        return f"The edits{animated} were written to {self.path}."


class FROG_OT_load_edits(_OfFile, ImportHelper, bpy.types.Operator):
    """Replace the edits of the capture by those of a file, and its timing if the file has one"""

    bl_idname = "frog.load_edits"
    bl_label = "Load Edits"

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        from ..engine.editing.edits_file import load_edits

        edits = load_edits(self.path)
        _, dropped = edits.fitted(scene_of(obj))
        if edits.timing is not None:
            check_editable(obj)  # before anything is changed
        write_edits(obj, edits, context.scene)
        if edits.timing is not None:
            write_timing(obj, edits.timing, context.scene)
        return " ".join([f"The edits of {self.path.name} were loaded.", *dropped])


def write_edits(obj: bpy.types.Object, edits: Edits, scene: bpy.types.Scene) -> None:
    """Makes edits those of a capture; crops become empties and meshes that hang on it.

    Raises:
        FrogError: for several grades of the whole capture, of which Blender has one. Then nothing has changed.
    """
    whole = [grade for grade in edits.grades if grade.only is None]
    if len(whole) > 1:
        raise FrogError(f"{obj.name}: found {len(whole)} grades of the whole capture, expected one.")
    settings = getattr(obj, SETTINGS)
    store_marks(settings.hidden, edits.hidden)
    for index in reversed(range(len(settings.crops))):
        remove_crop(obj, index)
    settings.grades.clear()
    for crop in edits.crops:
        _add_crop(obj, crop, scene)
    reset_grade(obj)
    for grade in edits.grades:
        _write_grade(settings.grade if grade.only is None else settings.grades.add(), grade)
    settings.use = True


def _write_grade(settings: Any, grade: Grade) -> None:
    for name in (*GRADE, "gains", "offsets"):
        setattr(settings, name, getattr(grade, name))
    if grade.only is not None:
        store_marks(settings.only, grade.only)


def _add_crop(obj: bpy.types.Object, crop: Crop, scene: bpy.types.Scene) -> None:
    data = None
    if crop.mesh is not None:
        data = bpy.data.meshes.new(f"{obj.name} Crop")
        vertices = np.frombuffer(crop.mesh.vertices, "<f4").reshape(-1, 3)
        data.from_pydata(vertices.tolist(), [], np.frombuffer(crop.mesh.triangles, "<i4").reshape(-1, 3).tolist())
    target, settings = new_crop(obj, scene, data)
    if data is None:
        target.empty_display_type, target.empty_display_size = crop.shape.replace("box", "cube").upper(), 1.0
    else:
        target.display_type = "WIRE"
    # Into the inverse of the parent, which holds any matrix; location, rotation and scale hold none that is sheared.
    target.matrix_parent_inverse = Matrix(np.array(crop.matrix).reshape(4, 4).tolist())
    settings.keep = "INSIDE" if crop.keep_inside else "OUTSIDE"
    settings.feather, settings.use_time, settings.time = crop.feather, crop.time is not None, crop.time or 0.0
