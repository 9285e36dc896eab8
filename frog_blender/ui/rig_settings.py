"""Settings of the rig that a capture of a Blender scene is rendered through."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

import math
from typing import Any

import bpy

from .. import properties
from ..engine.errors import FrogError
from ..properties import HIDDEN, choice, number, reference, whole
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


_PLACED: dict[str, Any] = {"update": _on_change}


class FrogRigSettings(bpy.types.PropertyGroup):
    """``Scene.frog.rig``."""

    box: reference(
        "Box",
        "The cameras look at the middle of this object and see all of it. Move and scale it as needed",
        bpy.types.Object,
        **_PLACED,
    )
    collection: reference(
        "Rig",
        "The collection of the rig's cameras. Cameras in it may be moved, added and deleted; a change of a setting "
        "places the rig's own anew",
        bpy.types.Collection,
        options=HIDDEN,
    )
    shape: choice("Shape", "Where the cameras stand", _SHAPES, "RINGS", **_PLACED)
    count: whole("Cameras", "Number of cameras", 12, min=1, soft_max=64, max=512, **_PLACED)
    arc: number(
        "Angle",
        "How much of a circle the arc spans",
        math.radians(120),
        subtype="ANGLE",
        min=math.radians(1),
        max=math.radians(360),
        **_PLACED,
    )
    lens: number(
        "Lens",
        "Focal length of the cameras for a sensor of 36 mm. Longer ones stand further away",
        50.0,
        subtype="DISTANCE_CAMERA",
        min=8.0,
        max=300.0,
        **_PLACED,
    )
    size: whole("Pixels", "Width and height of the images", 512, subtype="PIXEL", min=16, max=4096)
    folder: properties.folder(
        "Folder",
        "The capture is written here. Images that exist are kept: after a change of the scene, choose another folder "
        "or delete them",
        "//frog_capture",
    )
