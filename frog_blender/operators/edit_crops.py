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
from .edit_operator import EditOperator, chosen_in, mark, remove_crop, scene_of

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

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        crops = getattr(obj, SETTINGS).crops
        if self.shape == "OBJECT":
            known = {crop.object for crop in crops}
            found = [
                candidate
                for candidate in context.selected_objects
                if is_crop_object(candidate) and candidate not in known
            ]
            if not found:
                raise FrogError("Found no selected mesh or empty to crop with, expected one besides the capture.")
            for candidate in found:
                crops.add().object = candidate
            return ""
        scene = scene_of(obj)
        from ..engine.editing.common_view import common_view

        low, high = common_view(scene, addon_state.get(EditedScenes).weights(scene))
        half = np.maximum((high - low) / 2 * _MARGIN, 1e-6)
        crop = bpy.data.objects.new(f"{obj.name} Crop", None)
        crop.empty_display_type, crop.empty_display_size = ("CUBE" if self.shape == "BOX" else "SPHERE"), 1.0
        for collection in obj.users_collection or [context.scene.collection]:
            collection.objects.link(crop)
        crop.parent = obj
        sides = half if self.shape == "BOX" else np.full(3, float(np.linalg.norm(half)))
        matrix = np.diag([*sides, 1.0])
        matrix[:3, 3] = (low + high) / 2
        crop.matrix_basis = Matrix(matrix.tolist())
        crop.hide_render = True
        crops.add().object = crop
        return ""


class FROG_OT_remove_crop(EditOperator, bpy.types.Operator):
    """Remove a crop of the capture, and its empty if it was made for it"""

    bl_idname = "frog.remove_crop"
    bl_label = "Remove Crop"

    index: IntProperty(name="Index", min=0)

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> str:
        crops = getattr(obj, SETTINGS).crops
        if self.index >= len(crops):
            raise FrogError(f"{obj.name}: found {len(crops)} crops, expected one of the number {self.index}.")
        remove_crop(obj, self.index)
        return ""


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


class FROG_OT_remove_grade(EditOperator, bpy.types.Operator):
    """Remove a grade of a selection"""

    bl_idname = "frog.remove_grade"
    bl_label = "Remove Grade"

    index: IntProperty(name="Index", min=0)

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> str:
        grades = obj.frog_edits.grades
        if self.index >= len(grades):
            raise FrogError(f"{obj.name}: found {len(grades)} grades, expected one of the number {self.index}.")
        grades.remove(self.index)
        return ""


class FROG_OT_reset_grade(EditOperator, bpy.types.Operator):
    """Reset the grade of the whole capture"""

    bl_idname = "frog.reset_grade"
    bl_label = "Reset Grade"

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> str:
        for name in (*GRADE, "gains", "offsets"):
            obj.frog_edits.grade.property_unset(name)
        return ""


_CLASSES = (
    FROG_OT_add_crop,
    FROG_OT_remove_crop,
    FROG_OT_add_grade,
    FROG_OT_remove_grade,
    FROG_OT_reset_grade,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
