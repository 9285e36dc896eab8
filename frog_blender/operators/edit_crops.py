"""Adding and removing crops of a capture, and grades of its selections."""

# mypy: disable-error-code="valid-type"

from __future__ import annotations

import bpy
import numpy as np
from bpy.props import EnumProperty, IntProperty
from mathutils import Matrix

from .. import addon_state
from ..engine.errors import FrogError
from ..timeline.edited_scenes import EditedScenes
from ..timeline.edits import GRADE, SETTINGS, is_crop_object
from .bases import EditOperator, chosen_in, mark, new_crop, remove_crop, scene_of

_MARGIN = 1.05  # of a first crop around what the cameras see together


class FROG_OT_add_crop(EditOperator, bpy.types.Operator):
    """Crop the capture by a new box or sphere around what its cameras see together, or by the selected objects"""

    bl_idname = "frog.add_crop"
    bl_label = "Add Crop"

    shape: EnumProperty(
        name="Shape",
        items=(
            ("BOX", "Box", "A new box"),
            ("SPHERE", "Sphere", "A new sphere"),
            ("OBJECT", "Object", "The selected closed meshes, and empties shown as cubes or spheres"),
        ),
        default="BOX",
    )

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> None:
        if self.shape == "OBJECT":
            _crop_by(obj, context.selected_objects)
        else:
            self._add(obj, context.scene)

    def _add(self, obj: bpy.types.Object, scene: bpy.types.Scene) -> None:
        from ..engine.editing.selections import common_view

        playing = scene_of(obj)
        low, high = common_view(playing, addon_state.get(EditedScenes).weights(playing))
        sides = np.maximum((high - low) / 2 * _MARGIN, 1e-6)
        crop, _ = new_crop(obj, scene)
        crop.empty_display_type, crop.empty_display_size = "CUBE", 1.0
        if self.shape == "SPHERE":
            crop.empty_display_type, sides = "SPHERE", np.full(3, float(np.linalg.norm(sides)))
        crop.matrix_basis = Matrix.LocRotScale(((low + high) / 2).tolist(), None, sides.tolist())


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

    index: IntProperty(name="Index", min=0)
    entries = ""
    """The list of the capture's edits that it is in."""

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
        found = len(getattr(obj.frog_edits, self.entries))
        if self.index >= found:
            raise FrogError(f"{obj.name}: found {found} {self.entries}, expected one of the number {self.index}.")
        if self.entries == "crops":
            remove_crop(obj, self.index)
        else:
            obj.frog_edits.grades.remove(self.index)


class FROG_OT_remove_crop(_RemovesEntry, bpy.types.Operator):
    """Remove a crop of the capture, and its empty if it was made for it"""

    bl_idname = "frog.remove_crop"
    bl_label = "Remove Crop"
    entries = "crops"


class FROG_OT_remove_grade(_RemovesEntry, bpy.types.Operator):
    """Remove a grade of a selection"""

    bl_idname = "frog.remove_grade"
    bl_label = "Remove Grade"
    entries = "grades"


class FROG_OT_add_grade(EditOperator, bpy.types.Operator):
    """Add a grade of the selected Gaussians alone"""

    bl_idname = "frog.add_grade"
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

    bl_idname = "frog.reset_grade"
    bl_label = "Reset Grade"

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
        reset_grade(obj)


def reset_grade(obj: bpy.types.Object) -> None:
    """Gives the grade of a whole capture its defaults."""
    for name in (*GRADE, "gains", "offsets"):
        obj.frog_edits.grade.property_unset(name)
