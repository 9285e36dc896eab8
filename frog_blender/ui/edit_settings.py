"""``Object.frog_edits``: how a capture is cropped, cleaned and graded. The .frog file is never changed."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .. import relative_paths
from ..timeline import edits, edits_in_progress, playback

KEEPS = (
    ("INSIDE", "Inside", "Keep what is inside. Of several such crops, each keeps its own"),
    ("OUTSIDE", "Outside", "Keep what is outside"),
)


def _on_edit(_settings: Any, context: bpy.types.Context) -> None:
    if not (relative_paths.are_being_written() or edits_in_progress.are_any()):
        playback.refresh(context.scene)


def _can_crop(_settings: Any, obj: bpy.types.Object) -> bool:
    return edits.is_crop_object(obj)


class FrogMarks(bpy.types.PropertyGroup):
    """Marks on some of the Gaussians of a scene file; see ``engine.editing.marks``."""

    count: IntProperty(name="Gaussians", description="How many the scene file has", options={"HIDDEN"})
    scene: StringProperty(name="Scene", description="Which scene file they were made for", options={"HIDDEN"})
    bits: StringProperty(
        name="Marks", description="A bit for each Gaussian, packed", options={"HIDDEN"}, update=_on_edit
    )


class FrogCrop(bpy.types.PropertyGroup):
    """A crop of a capture."""

    object: PointerProperty(
        name="Object",
        description="What crops: an empty shown as a cube or a sphere, or a closed mesh",
        type=bpy.types.Object,
        poll=_can_crop,
        update=_on_edit,
    )
    use: BoolProperty(name="Use", description="Whether it crops", default=True, update=_on_edit)
    keep: EnumProperty(
        name="Keep", description="What to keep of the capture", items=KEEPS, default="INSIDE", update=_on_edit
    )
    feather: FloatProperty(
        name="Feather",
        description="Distance from the surface over which what is cropped fades, in the capture's units",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        update=_on_edit,
    )
    use_time: BoolProperty(
        name="At One Time",
        description="Crop each Gaussian by its place at one time of the capture, for all times. Otherwise by its place "
        "at the shown time",
        default=False,
        update=_on_edit,
    )
    time: FloatProperty(
        name="Time",
        description="That time: 0 is the capture's first frame, 1 its last",
        default=0.0,
        min=0.0,
        max=1.0,
        update=_on_edit,
    )


def _factor(name: str, description: str, most: float = 2.0) -> Any:
    return FloatProperty(
        name=name, description=description, default=1.0, min=0.0, max=10.0, soft_max=most, update=_on_edit
    )


def _stops(name: str, description: str, most: float) -> Any:
    return FloatProperty(
        name=name,
        description=description,
        default=0.0,
        min=-most,
        max=most,
        soft_min=-2.0,
        soft_max=2.0,
        update=_on_edit,
    )


class FrogGrade(bpy.types.PropertyGroup):
    """A grade of a capture, or of some of its Gaussians."""

    use: BoolProperty(name="Use", description="Whether it is applied", default=True, update=_on_edit)
    exposure: _stops("Exposure", "Brightness, in stops", 20.0)
    contrast: _factor("Contrast", "Factor of the distance from middle grey")
    saturation: _factor("Saturation", "Factor of the distance from grey. 0 leaves no colour")
    temperature: _stops("Temperature", "White balance: positive is warmer, in stops between red and blue", 4.0)
    tint: _stops("Tint", "White balance: positive is more magenta, in stops between green and magenta", 4.0)
    opacity: _factor("Opacity", "Factor of the Gaussians' opacities", 1.0)
    size: _factor("Size", "Factor of the Gaussians' sizes")
    gains: FloatVectorProperty(
        name="Gain",
        description="Factors of red, green and blue, after everything else",
        default=(1.0, 1.0, 1.0),
        min=-100.0,
        max=100.0,
        soft_min=0.0,
        soft_max=2.0,
        update=_on_edit,
    )
    offsets: FloatVectorProperty(
        name="Offset",
        description="Added to red, green and blue, after everything else",
        min=-100.0,
        max=100.0,
        soft_min=-1.0,
        soft_max=1.0,
        update=_on_edit,
    )
    only: PointerProperty(name="Selection", description="The Gaussians that it is for", type=FrogMarks)


class FrogEdits(bpy.types.PropertyGroup):
    """Everything that is edited of a capture."""

    use: BoolProperty(
        name="Edits",
        description="Show the capture with its edits. Otherwise as it was trained",
        default=True,
        update=_on_edit,
    )
    hidden: PointerProperty(name="Hidden", description="The Gaussians that are not shown", type=FrogMarks)
    selection: PointerProperty(name="Selected", description="The selected Gaussians", type=FrogMarks)
    show_selection: BoolProperty(
        name="Show Selection",
        description="Colour selected Gaussians in viewports. FRoG's renders never show it; other engines' do unless "
        "Render > Lock Interface is enabled",
        default=True,
        update=_on_edit,
    )
    crops: CollectionProperty(name="Crops", description="The crops of the capture", type=FrogCrop)
    grade: PointerProperty(name="Grade", description="The grade of the whole capture", type=FrogGrade)
    match_image: PointerProperty(
        name="Image",
        description="The image whose colours to match. Empty for the other selected capture",
        type=bpy.types.Image,
    )
    grades: CollectionProperty(name="Grades", description="Grades of selections, one after the other", type=FrogGrade)


_CLASSES = (FrogMarks, FrogCrop, FrogGrade, FrogEdits)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.Object.frog_edits = PointerProperty(type=FrogEdits)


def unregister() -> None:
    del bpy.types.Object.frog_edits
    _unregister_classes()
