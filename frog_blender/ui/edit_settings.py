"""``Object.frog_edits``: how a capture is cropped, cleaned and graded. The .frog file is never changed."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from functools import partial
from typing import Any

import bpy

from ..properties import HIDDEN, choice, listed, number, reference, switch, text, vector, whole
from ..timeline import edits, playback

KEEPS = (
    ("INSIDE", "Inside", "Keep what is inside. Of several such crops, each keeps its own"),
    ("OUTSIDE", "Outside", "Keep what is outside"),
)


_EDITED: dict[str, Any] = {"update": playback.on_setting}
_switch = partial(switch, **_EDITED)
_factor = partial(number, default=1.0, min=0.0, max=10.0, **_EDITED)
_stops = partial(number, soft_min=-2.0, soft_max=2.0, **_EDITED)
_colors = partial(vector, min=-100.0, max=100.0, **_EDITED)


def _on_crop_object(settings: Any, context: bpy.types.Context) -> None:
    edits.show_as_crops()
    playback.on_setting(settings, context)


class FrogMarks(bpy.types.PropertyGroup):
    """Marks on some of the Gaussians of a scene file; see ``engine.editing.marks``."""

    count: whole("Gaussians", "How many the scene file has", options=HIDDEN)
    scene: text("Scene", "Which scene file they were made for", options=HIDDEN)
    bits: text("Marks", "A bit for each Gaussian, packed", options=HIDDEN, **_EDITED)


class FrogCrop(bpy.types.PropertyGroup):
    """A crop of a capture."""

    object: reference(
        "Object",
        "What crops: an empty shown as a cube or a sphere, or a closed mesh",
        bpy.types.Object,
        poll=lambda _settings, obj: edits.is_crop_object(obj),
        update=_on_crop_object,
    )
    use: _switch("Use", "Whether it crops", True)
    keep: choice("Keep", "What to keep of the capture", KEEPS, "INSIDE", **_EDITED)
    feather: number(
        "Feather",
        "Distance from the surface over which what is cropped fades, in the capture's units",
        min=0.0,
        soft_max=1.0,
        **_EDITED,
    )
    use_time: _switch(
        "Same Gaussians",
        "Crop the same Gaussians at all times, by where they are at one. Otherwise by where they are at the shown time",
    )
    time: number("Time", "When that is: 0 is the capture's first frame, 1 its last", min=0.0, max=1.0, **_EDITED)


class FrogGrade(bpy.types.PropertyGroup):
    """A grade of a capture, or of some of its Gaussians."""

    use: _switch("Use", "Whether it is applied", True)
    exposure: _stops("Exposure", "Brightness, in stops", min=-20.0, max=20.0)
    contrast: _factor("Contrast", "Factor of the distance from middle grey", soft_max=2.0)
    saturation: _factor("Saturation", "Factor of the distance from grey. 0 leaves no colour", soft_max=2.0)
    temperature: _stops(
        "Temperature", "White balance: positive is warmer, in stops between red and blue", min=-4.0, max=4.0
    )
    tint: _stops(
        "Tint", "White balance: positive is more magenta, in stops between green and magenta", min=-4.0, max=4.0
    )
    opacity: _factor("Opacity", "Factor of the Gaussians' opacities", soft_max=1.0)
    size: _factor("Size", "Factor of the Gaussians' sizes", soft_max=2.0)
    gains: _colors(
        "Gain", "Factors of red, green and blue, after everything else", (1.0, 1.0, 1.0), soft_min=0.0, soft_max=2.0
    )
    offsets: _colors(
        "Offset", "Added to red, green and blue, after everything else", (0.0, 0.0, 0.0), soft_min=-1.0, soft_max=1.0
    )
    only: reference("Selection", "The Gaussians that it is for", FrogMarks)


class FrogEdits(bpy.types.PropertyGroup):
    """Everything that is edited of a capture."""

    attached_to = bpy.types.Object, "frog_edits"

    use: _switch("Edits", "Show the capture with its edits. Otherwise as it was trained", True)
    hidden: reference("Hidden", "The Gaussians that are not shown", FrogMarks)
    selection: reference("Selected", "The selected Gaussians", FrogMarks)
    show_selection: _switch(
        "Show Selection",
        "Colour selected Gaussians in viewports. FRoG's renders never show it; other engines' do unless Render > Lock "
        "Interface is enabled",
        True,
    )
    clean_strength: number(
        "Strength", "How much Clean Up may hide. At 1 images may lose 0.02 dB", 0.5, min=0.0, max=1.0, subtype="FACTOR"
    )
    grow_distance: number(
        "Grow By", "How far, in the capture's units. 0 for the mean spacing of its Gaussians", min=0.0, soft_max=1.0
    )
    crops: listed("Crops", "The crops of the capture", FrogCrop)
    grade: reference("Grade", "The grade of the whole capture", FrogGrade)
    grades: listed("Grades", "Grades of selections, one after the other", FrogGrade)
