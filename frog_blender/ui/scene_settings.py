"""``Scene.frog``: how FROG renders and viewports draw and, where the add-on trains, what to train and how."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

import bpy

from .. import edition
from ..properties import HIDDEN, choice, reference, switch, text, whole
from ..render.blur import LENS_SAMPLES, SHUTTER_SAMPLES
from ..viewport import drawing
from .captures_panel import ChoosesCapture

if edition.TRAINS:
    from .training_settings import TrainingSettings as _Training
else:

    class _Training:  # type: ignore[no-redef]
        """The player trains nothing."""


DRAWINGS = (
    ("AUTO", "Automatic", "Splats, drawn by Blender itself where it can"),
    ("CARD", "Splats", "The splats themselves, drawn by the graphics card and hidden by what lies before them"),
    ("POINTS", "Points", "An object of points, which other engines render as well"),
)


class FrogSceneSettings(_Training, ChoosesCapture, bpy.types.PropertyGroup):
    """Settings of a scene."""

    attached_to = bpy.types.Scene, "frog"

    hold_out: switch(
        "Objects Hide Splats", "Objects of this scene occlude the splats. The objects themselves are not drawn"
    )
    motion_samples: whole(
        "Samples",
        "Moments within the shutter time that motion blur averages. More of them blur fast motion more smoothly and "
        "take longer",
        SHUTTER_SAMPLES,
        min=1,
        soft_max=64,
        max=1024,
    )
    lens_samples: whole(
        "Samples",
        "Points of the lens that depth of field averages, for cameras that have it. More of them make wide blurs "
        "smoother and take longer",
        LENS_SAMPLES,
        min=1,
        soft_max=128,
        max=4096,
    )
    composed_with: reference(
        "Composed With",
        "The scene of the user's objects that this scene of captures belongs to",
        bpy.types.Scene,
        options=HIDDEN,
    )
    own_world: reference(
        "Own World", "The scene's world before a capture lit its objects", bpy.types.World, options=HIDDEN
    )
    viewport_drawing: choice(
        "In Viewports",
        "What viewports show of captures in Solid, Material Preview, Wireframe and other engines' Rendered mode",
        DRAWINGS,
        "AUTO",
        update=drawing.choose,
    )
    set_up_as: text(
        "Set Up As",
        "The scene's settings when FRoG last set them up, to tell whether they were changed since",
        options=HIDDEN,
    )
