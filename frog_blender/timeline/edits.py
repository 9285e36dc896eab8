"""The edits of a capture's object as they are at a frame: its settings, and its crop objects, as plain values."""

from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from .. import addon_state, point_cloud
from ..capture_files import is_capture
from ..engine.editing.crops import Crop
from ..engine.editing.edits import Edits
from ..engine.editing.grades import RANGES, Grade
from ..engine.editing.marks import Marks
from ..engine.errors import FrogError
from .edited_scenes import EditedScenes
from .retiming import animated_paths

SETTINGS = "frog_edits"
"""The name of the edits on objects."""
GRADE = ("exposure", "contrast", "saturation", "temperature", "tint", "opacity", "size")
_SHADE, _SELECTED = 0.35, (0.65, 0.35, 0.0)  # what is left of a selected Gaussian's colour, and orange added
TAKEN_AWAY = Grade(gains=(_SHADE,) * 3, offsets=(0.65, 0.0, 0.1))
"""How viewports show what crops would take away, while these are transformed."""
_SHOWN_AS = "frog_shown_as"  # of meshes that crop: how they were drawn before
_EMPTIES = {"CUBE": "box", "SPHERE": "sphere"}


def edits_of(
    obj: bpy.types.Object, evaluated: bpy.types.Object | None = None, *, even_unused: bool = False
) -> Edits | None:
    """What is edited of a capture; None for nothing.

    Args:
        evaluated: the object as a depsgraph has it at a frame, where one was evaluated.
        even_unused: also while the capture is shown without its edits.

    Raises:
        FrogError: for a crop object that cannot crop.
    """
    settings = getattr(obj if evaluated is None else evaluated, SETTINGS)
    cropped = addon_state.get(EditedScenes).cropped
    (cropped.add if len(settings.crops) else cropped.discard)(obj.session_uid)
    if not (settings.use or even_unused) or not _has_any(settings):
        return None

    is_still = not needs_evaluation(obj, even_unused=even_unused)
    crops = [_crop(obj, evaluated, crop, is_still) for crop in settings.crops if crop.use and crop.object is not None]
    only = [_grade(grade, marks_of(grade.only)) for grade in settings.grades if grade.use]
    return Edits(marks_of(settings.hidden), tuple(crops), (_grade(settings.grade, None), *only))


def _has_any(settings: Any) -> bool:
    """Whether there is any edit, in use or not."""
    is_graded = any(settings.grade.is_property_set(name) for name in (*GRADE, "gains", "offsets"))
    return bool(settings.hidden.bits or len(settings.crops) or len(settings.grades) or is_graded)


def _grade(settings: Any, only: Marks | None) -> Grade:
    # A driver may set anything.
    values = {name: min(max(getattr(settings, name), RANGES[name][0]), RANGES[name][1]) for name in GRADE}
    values = {name: value if value == value else getattr(Grade(), name) for name, value in values.items()}
    gains, offsets = (tuple(getattr(settings, name)) for name in ("gains", "offsets"))
    return Grade(**values, gains=gains, offsets=offsets, only=only)


def marks_of(settings: Any) -> Marks | None:
    """The marks that a group of properties holds; None for none, and for damaged ones, which a script may have made."""
    if not settings.bits:
        return None
    return addon_state.get(EditedScenes).marks(settings.count, settings.scene, settings.bits)


def store_marks(settings: Any, marks: Marks | None) -> None:
    """Writes marks to a group of properties; None and marks of nothing empty it."""
    if marks is None or not marks.number():
        settings.count, settings.scene, settings.bits = 0, "", ""
    else:
        settings.count, settings.scene, settings.bits = marks.count, marks.scene, marks.to_text()


def is_crop_object(obj: bpy.types.Object) -> bool:
    """Whether an object can crop: an empty shown as a cube or a sphere, or a mesh."""
    return (obj.type == "EMPTY" and obj.empty_display_type in _EMPTIES) or (obj.type == "MESH" and not is_capture(obj))


def show_as_crops() -> None:
    """Draws meshes that crop as wires and keeps them out of renders, as their faces would cover what they keep; others
    as they were before.
    """
    used = {crop.object for obj in bpy.data.objects for crop in getattr(obj, SETTINGS).crops}
    for obj in (mesh for mesh in bpy.data.objects if mesh.type == "MESH" and mesh.library is None):
        if obj in used and _SHOWN_AS not in obj:
            obj[_SHOWN_AS] = f"{obj.display_type} {obj.hide_render:d}"
            obj.display_type, obj.hide_render = "WIRE", True
        elif obj not in used and _SHOWN_AS in obj:
            obj.display_type, hidden = obj.pop(_SHOWN_AS).split()
            obj.hide_render = hidden == "1"


def _crop(obj: bpy.types.Object, evaluated: bpy.types.Object | None, settings: Any, is_still: bool) -> Crop:
    target = settings.object
    if not is_crop_object(target):
        raise FrogError(f"{target.name}: found no mesh, and no empty shown as a cube or sphere, expected one to crop.")
    shape, mesh, matrix = "mesh", None, _in_capture(obj, evaluated, target)
    try:
        if target.type == "EMPTY":
            shape = _EMPTIES[target.empty_display_type]
            matrix = matrix @ np.diag([*[target.empty_display_size] * 3, 1.0])
        else:
            points, corners = point_cloud.triangles_of(target.original.data)
            mesh = addon_state.get(EditedScenes).mesh(points.astype("<f4").tobytes(), corners.astype("<i4").tobytes())
        return Crop(
            shape,
            tuple(matrix.ravel().tolist()),
            settings.keep == "INSIDE",
            max(settings.feather, 0.0),
            min(max(settings.time, 0.0), 1.0) if settings.use_time else None,
            mesh,
            is_still,
        )
    except ValueError as error:
        raise FrogError(f"{target.name}: found {error}, expected a box, a sphere or a closed mesh to crop.") from error


def _in_capture(obj: bpy.types.Object, evaluated: bpy.types.Object | None, target: bpy.types.Object) -> np.ndarray:
    """(4, 4) from a crop object's space to the capture's own.

    A child of a capture stays where it is among its Gaussians, and so does that of a duplicate's original.
    """
    if _hangs_on_capture(target):
        return np.array(target.matrix_parent_inverse, np.float64) @ np.array(target.matrix_basis, np.float64)
    world, own = (np.array(posed.matrix_world, np.float64) for posed in (target, evaluated or obj))
    if not own[:3, :3].any():
        return np.eye(4)
    try:
        result: np.ndarray = np.linalg.solve(own, world)
    except np.linalg.LinAlgError:
        raise FrogError(
            f"{obj.name}: found a scale of zero along an axis, expected none for {target.name} to crop it."
        ) from None
    result[3] = 0, 0, 0, 1
    return result


def _hangs_on_capture(target: bpy.types.Object) -> bool:
    parent = target.parent
    return parent is not None and target.parent_type == "OBJECT" and not target.constraints and is_capture(parent)


def needs_evaluation(obj: bpy.types.Object, *, even_unused: bool = False) -> bool:
    """Whether a capture's edits at a frame depend on Blender's evaluation of it: something of them is animated."""
    if any(path.startswith(f"{SETTINGS}.") for path in animated_paths(obj)):
        return True  # what is off or neutral now may be animated
    settings = getattr(obj, SETTINGS)
    if not (settings.use or even_unused):
        return False
    targets = [crop.object for crop in settings.crops if crop.use and crop.object is not None]
    return any(animated_paths(target) or not _hangs_on_capture(target) for target in targets)


def cropped_by(objects: set[bpy.types.Object], captures: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """Those captures that any of the objects crops, or that are among the objects and so moved within their crops."""
    cropped = []
    for obj in captures:
        targets = [crop.object for crop in getattr(obj, SETTINGS).crops if crop.object is not None]
        is_moved = obj in objects and not all(map(_hangs_on_capture, targets))
        if is_moved or not objects.isdisjoint(targets):
            cropped.append(obj)
    return cropped


def has_shown_selection(obj: bpy.types.Object) -> bool:
    """Whether selected Gaussians of a capture stand out in viewports."""
    settings = getattr(obj, SETTINGS)
    return settings.show_selection and bool(settings.selection.bits)


def with_selection(obj: bpy.types.Object, edits: Edits | None) -> Edits | None:
    """Edits after which selected Gaussians stand out in Blender's own colour of what is selected."""
    if not has_shown_selection(obj) or bpy.app.background:
        return edits
    selection = marks_of(getattr(obj, SETTINGS).selection)
    if selection is None:
        return edits
    return graded(edits, Grade(gains=(_SHADE,) * 3, offsets=_SELECTED, only=selection))


def are_crops_transformed(obj: bpy.types.Object) -> bool:
    """Whether the user moves, turns or scales a crop of a capture at this moment."""
    crops = [crop.object for crop in getattr(obj, SETTINGS).crops if crop.object is not None]
    return bool(crops) and is_transforming() and any(crop.select_get() for crop in crops)


def is_transforming() -> bool:
    """Whether an operator that transforms follows the mouse in a window."""
    windows = bpy.context.window_manager.windows
    return any(operator.bl_idname.startswith("TRANSFORM_OT") for win in windows for operator in win.modal_operators)


def graded(edits: Edits | None, grade: Grade) -> Edits:
    """Edits with one more grade."""
    return Edits(grades=(grade,)) if edits is None else replace(edits, grades=(*edits.grades, grade))
