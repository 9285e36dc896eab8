"""Match Colours: the grade of a capture, so that it looks like another capture or an image."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ..engine.errors import FrogError
from ..scene_import.capture_objects import root_of
from ..timeline import playback
from ..timeline.edits import edits_of
from .bases import EditOperator, scene_of

_MOST_PIXELS = 1 << 20


class FROG_OT_match_grade(EditOperator, bpy.types.Operator):
    """Set gain and offset so that the capture's colours have the mean and the spread of the chosen image, or of the \
other selected capture without one"""

    bl_idname = "frog.match_grade"
    bl_label = "Match Colours"

    def edit(self, context: bpy.types.Context, obj: bpy.types.Object) -> str:
        from ..engine.editing.edited_scene import edited
        from ..engine.editing.edits import Edits
        from ..engine.editing.matching import Colors, matched

        image, scene = obj.frog_edits.match_image, scene_of(obj)
        if image is not None:
            wanted, name = Colors.of_pixels(_pixels(image)), image.name
        else:
            other = _other_capture(context, obj)
            theirs = edited(scene_of(other), edits_of(other) or Edits())[0]
            wanted, name = Colors.of_scene(theirs), other.name
        edits = edits_of(obj, even_unused=True) or Edits()  # what is set here is one of them
        # As it is without the gain and the offset that are set here.
        grades = tuple(
            grade if grade.only else replace(grade, gains=(1.0,) * 3, offsets=(0.0,) * 3) for grade in edits.grades
        )
        own = Colors.of_scene(edited(scene, replace(edits, grades=grades))[0])
        gains, offsets = matched(own, wanted)
        grade = obj.frog_edits.grade
        grade.gains, grade.offsets = gains.tolist(), offsets.tolist()
        return f"The colours were matched to {name}."


def _other_capture(context: bpy.types.Context, obj: bpy.types.Object) -> bpy.types.Object:
    selected = set(context.selected_objects)
    found = [
        other
        for other in playback.captures(context.scene.objects)
        if other != obj and ({other, root_of(other)} & selected)
    ]
    if len(found) != 1:
        raise FrogError(f"Found {len(found)} other selected captures, expected one, or an image to match.")
    return found[0]


def _pixels(image: bpy.types.Image) -> np.ndarray:
    """(P, 3) display-referred colours of an image, of at most about a million of its pixels."""
    from ..engine.srgb import linear_to_srgb

    if not (image.size[0] and image.size[1]) or not image.channels:
        raise FrogError(f"{image.name}: found no pixels, expected an image that can be read.")
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    pixels = values.reshape(-1, image.channels)
    pixels = pixels[:: -(-len(pixels) // _MOST_PIXELS)]
    colors = pixels[:, :3] if image.channels >= 3 else np.repeat(pixels[:, :1], 3, axis=1)
    return np.clip(linear_to_srgb(np.maximum(colors, 0)) if image.is_float else colors, 0, 1)
