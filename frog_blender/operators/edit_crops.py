"""Crops of a capture, grades of it and of its selections, and all edits as a small JSON file."""

# mypy: disable-error-code="valid-type"

from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper, ImportHelper
from mathutils import Matrix

from ..engine.editing.crops import Crop
from ..engine.editing.edits import Edits
from ..engine.editing.edits_file import load_edits, save_edits
from ..engine.editing.grades import Grade
from ..engine.editing.selections import seen_box
from ..engine.errors import FrogError
from ..engine.playback.player import ScenePlayer
from ..properties import choice, whole
from ..scene_import.capture_objects import root_of, select_capture, select_only
from ..timeline.edits import GRADE, SETTINGS, edits_of, is_crop_object, needs_evaluation, show_as_crops, store_marks
from ..timeline.frame_timing import timing_of, write_timing
from ..timeline.retiming import is_plain, needs_evaluated_time
from ..timeline.timing_curve import check_editable
from .bases import CaptureFileOperator, EditOperator, chosen_in, mark, scene_of
from .worked_out import LOOKING, Work, WorkedOutEdit, weights_of

_MARGIN = 1.05  # of a first crop around what the cameras see, which may move between the frames that were looked at


class FROG_OT_add_crop(WorkedOutEdit, bpy.types.Operator):
    """Crop the capture by a new box or sphere around all that its cameras see, or by the selected objects"""

    bl_label = "Add Crop"

    shape: choice(
        "Shape",
        "",
        (
            ("BOX", "Box", "A new box"),
            ("SPHERE", "Sphere", "A new sphere"),
            ("OBJECT", "Object", "The selected closed meshes, and empties shown as cubes or spheres"),
        ),
    )

    plan = ((LOOKING, 1.0),)

    def work_out(self, _context: bpy.types.Context, _obj: bpy.types.Object, scene: ScenePlayer) -> Work:
        if self.shape == "OBJECT":
            return lambda _: None
        return lambda tell: seen_box(scene, weights_of(scene, tell))

    def apply(self, context: bpy.types.Context, obj: bpy.types.Object, result: np.ndarray | None) -> str:
        if result is None:
            _crop_by(obj, context.selected_objects)
        else:
            crop = self._added(obj, context.scene, *result)
            context.view_layer.update()  # which has it from then on
            if crop.name in context.view_layer.objects:  # its collection may be excluded
                select_only(context, crop)
        return ""

    def _added(
        self, obj: bpy.types.Object, scene: bpy.types.Scene, low: np.ndarray, high: np.ndarray
    ) -> bpy.types.Object:
        sides = np.maximum((high - low) / 2 * _MARGIN, 1e-6)
        crop, _ = new_crop(obj, scene)
        crop.empty_display_type, crop.empty_display_size = "CUBE", 1.0
        if self.shape == "SPHERE":
            crop.empty_display_type, sides = "SPHERE", np.full(3, float(np.linalg.norm(sides)))
        crop.matrix_basis = Matrix.LocRotScale(((low + high) / 2).tolist(), None, sides.tolist())
        return crop


def _crop_by(obj: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    """Crops a capture by those of some objects that can; FrogError for none."""
    crops = getattr(obj, SETTINGS).crops
    known = {crop.object for crop in crops}
    new = [candidate for candidate in objects if is_crop_object(candidate) and candidate not in known]
    if not new:
        raise FrogError("Found no selected mesh or empty to crop with, expected one besides the capture.")
    for candidate in new:
        crops.add().object = candidate


class _RemovesEntry(EditOperator):
    """Base of operators that remove one of several crops or grades."""

    index: whole("Index", "", min=0)
    entries = ""
    """The list of the capture's edits that it is in."""

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        count = len(getattr(obj.frog_edits, self.entries))
        if self.index >= count:
            raise FrogError(f"{obj.name}: found {count} {self.entries}, expected one of the number {self.index}.")
        if self.entries == "crops":
            remove_crop(obj, self.index)
            if context.object is None and root_of(obj).name in context.view_layer.objects:  # what was active is gone
                select_capture(context, obj)
        else:
            obj.frog_edits.grades.remove(self.index)


class FROG_OT_remove_crop(_RemovesEntry, bpy.types.Operator):
    """Remove a crop of the capture, and its empty if it was made for it"""

    bl_label = "Remove Crop"
    entries = "crops"


class FROG_OT_remove_grade(_RemovesEntry, bpy.types.Operator):
    """Remove a grade of a selection"""

    bl_label = "Remove Grade"
    entries = "grades"


class FROG_OT_add_grade(EditOperator, bpy.types.Operator):
    """Add a grade of the selected Gaussians alone"""

    bl_label = "Grade Selection"
    needs = "selection"

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> str:
        scene, settings = scene_of(obj), obj.frog_edits
        chosen = chosen_in(settings.selection, scene)
        if not chosen.any():
            raise FrogError(f"{obj.name}: found no selected Gaussian, expected some to grade.")
        mark(settings.grades.add().only, scene, chosen)
        return f"A grade of {np.count_nonzero(chosen):,} Gaussians was added."


class FROG_OT_reset_grade(EditOperator, bpy.types.Operator):
    """Reset the grade of the whole capture"""

    bl_label = "Reset Grade"

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
        reset_grade(obj.frog_edits.grade)


def reset_grade(grade: Any) -> None:
    """Gives a grade its defaults."""
    for name in (*GRADE, "gains", "offsets"):
        grade.property_unset(name)


class _OfFile(EditOperator, CaptureFileOperator):
    """Base, with a helper of Blender's for file browsers, of operators on a file of edits."""

    filename_ext, suffix = ".json", ".edits.json"


class FROG_OT_save_edits(_OfFile, ExportHelper, bpy.types.Operator):
    """Write the edits of the capture as they are at the current frame, and its timing in the scene's frame range, for \
``frog render --edits`` and other files"""

    bl_label = "Save Edits"
    bl_options = {"REGISTER"}

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
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

    bl_label = "Load Edits"

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
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
    reset_grade(settings.grade)
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
        vertices, triangles = crop.mesh.arrays
        data.from_pydata(vertices.tolist(), [], triangles.tolist())
    target, settings = new_crop(obj, scene, data)
    if data is None:
        target.empty_display_type, target.empty_display_size = crop.shape.replace("box", "cube").upper(), 1.0
    # Into the inverse of the parent, which holds any matrix; location, rotation and scale hold none that is sheared.
    target.matrix_parent_inverse = Matrix(np.array(crop.matrix).reshape(4, 4).tolist())
    settings.keep = "INSIDE" if crop.keep_inside else "OUTSIDE"
    settings.feather, settings.use_time, settings.time = crop.feather, crop.time is not None, crop.time or 0.0


def new_crop(
    obj: bpy.types.Object, scene: bpy.types.Scene, data: bpy.types.Mesh | None = None
) -> tuple[bpy.types.Object, Any]:  # Any: Blender's properties
    """An object that crops a capture and hangs on it, an empty without data; and its settings."""
    target = bpy.data.objects.new(f"{obj.name} Crop", data)
    for collection in obj.users_collection or [scene.collection]:
        collection.objects.link(target)
    target.hide_render = True
    target.parent = obj
    settings = getattr(obj, SETTINGS).crops.add()
    settings.object = target
    return target, settings


def remove_crop(obj: bpy.types.Object, index: int) -> None:
    """Removes a crop of a capture, and the empty that hangs on the capture for it unless something else is cropped by
    it. A mesh may be anybody's work, and stays.
    """
    crops = getattr(obj, SETTINGS).crops
    target = crops[index].object
    crops.remove(index)
    show_as_crops()
    hangs_on_it = target is not None and target.type == "EMPTY" and target.parent == obj
    if hangs_on_it and not cropped_with(target):
        bpy.data.objects.remove(target)


def cropped_with(target: bpy.types.Object) -> set[bpy.types.Object]:
    """The captures that an object crops."""
    return {obj for obj in bpy.data.objects if any(crop.object == target for crop in getattr(obj, SETTINGS).crops)}
