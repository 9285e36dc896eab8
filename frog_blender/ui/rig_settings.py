"""Settings of the rig that a capture of a Blender scene is rendered through."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

import math
from typing import Any

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ..engine.errors import FrogError
from ..relative_paths import PATH_OPTIONS
from ..scene_capture import placing

_SHAPES = (
    ("RINGS", "Rings", "One ring around the box, two from 8 cameras, three from 24"),
    ("DOME", "Dome", "All over the upper half, evenly"),
    ("ARC", "Arc", "Before the front of the box, which is where Blender's front view looks from"),
)


def _on_change(settings: Any, _context: bpy.types.Context) -> None:
    """Places the cameras anew where there are some, so that one sees what one sets."""
    if placing.placed(settings):
        try:
            placing.place(settings.id_data, settings)
        except FrogError as error:  # a box may be gone; the operator says so when it is pressed
            print(f"FRoG: {error}")


class FrogRigSettings(bpy.types.PropertyGroup):
    """``Scene.frog.rig``."""

    box: PointerProperty(
        name="Box",
        description="The cameras look at the middle of this object and see all of it. Move and scale it as needed",
        type=bpy.types.Object,
        update=_on_change,
    )
    collection: PointerProperty(
        name="Rig",
        description="The collection of the rig's cameras. Cameras in it may be moved, added and deleted; "
        "a change of a setting places the rig's own anew",
        type=bpy.types.Collection,
        options={"HIDDEN"},
    )
    shape: EnumProperty(
        name="Shape", description="Where the cameras stand", items=_SHAPES, default="RINGS", update=_on_change
    )
    count: IntProperty(
        name="Cameras", description="Number of cameras", min=1, soft_max=64, max=512, default=12, update=_on_change
    )
    arc: FloatProperty(
        name="Angle",
        description="How much of a circle the arc spans",
        subtype="ANGLE",
        min=math.radians(1),
        max=math.radians(360),
        default=math.radians(120),
        update=_on_change,
    )
    lens: FloatProperty(
        name="Lens",
        description="Focal length of the cameras for a sensor of 36 mm. Longer ones stand further away",
        subtype="DISTANCE_CAMERA",
        min=8.0,
        max=300.0,
        default=50.0,
        update=_on_change,
    )
    size: IntProperty(
        name="Pixels",
        description="Width and height of the images",
        subtype="PIXEL",
        min=16,
        max=4096,
        default=512,
    )
    folder: StringProperty(
        name="Folder",
        description="The capture is written here. Images that exist are kept: after a change of the scene, choose "
        "another folder or delete them",
        subtype="DIR_PATH",
        default="//frog_capture",
        options=PATH_OPTIONS,
    )
