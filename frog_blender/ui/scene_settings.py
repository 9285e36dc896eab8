"""``Scene.frog``: how FROG renders and viewports draw and, where the add-on trains, what to train and how."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, PointerProperty, StringProperty

from .. import edition
from ..render.blur import LENS_SAMPLES, SHUTTER_SAMPLES
from .capture_list import ChoosesCapture

if edition.TRAINS:
    from .rig_settings import FrogRigSettings
    from .training_settings import TrainingSettings as _Training

    _CLASSES: tuple[type, ...] = (FrogRigSettings,)
else:

    class _Training:  # type: ignore[no-redef]
        """The player trains nothing."""

    _CLASSES = ()

DRAWINGS = (
    ("AUTO", "Automatic", "Splats, drawn by Blender itself where it can"),
    (
        "CARD",
        "Splats",
        "The splats themselves, drawn by the graphics card and hidden by what lies before them",
    ),
    ("POINTS", "Points", "An object of points, which other engines render as well"),
)


def _on_viewport_drawing(_settings: Any, _context: bpy.types.Context) -> None:
    from ..viewport import drawing  # imported late: it draws, and settings are read everywhere

    drawing.choose()


class FrogSceneSettings(_Training, ChoosesCapture, bpy.types.PropertyGroup):
    """Settings of a scene."""

    hold_out: BoolProperty(
        name="Objects Hide Splats",
        description="Objects of this scene occlude the splats. The objects themselves are not drawn",
        default=False,
    )
    motion_samples: IntProperty(
        name="Samples",
        description="Moments within the shutter time that motion blur averages. More of them blur fast motion more "
        "smoothly and take longer",
        default=SHUTTER_SAMPLES,
        min=1,
        soft_max=64,
        max=1024,
    )
    lens_samples: IntProperty(
        name="Samples",
        description="Points of the lens that depth of field averages, for cameras that have it. More of them make wide "
        "blurs smoother and take longer",
        default=LENS_SAMPLES,
        min=1,
        soft_max=128,
        max=4096,
    )
    composed_with: PointerProperty(
        name="Composed With",
        description="The scene of the user's objects that this scene of captures belongs to",
        type=bpy.types.Scene,
        options={"HIDDEN"},
    )
    own_world: PointerProperty(
        name="Own World",
        description="The scene's world before a capture lit its objects",
        type=bpy.types.World,
        options={"HIDDEN"},
    )
    viewport_drawing: EnumProperty(
        name="In Viewports",
        description="What viewports show of captures in Solid, Material Preview, Wireframe and other engines' Rendered "
        "mode",
        items=DRAWINGS,
        default="AUTO",
        update=_on_viewport_drawing,
    )
    set_up_as: StringProperty(
        name="Set Up As",
        description="The scene's settings when FRoG last set them up, to tell whether they were changed since",
        options={"HIDDEN"},
    )


_register_classes, _unregister_classes = bpy.utils.register_classes_factory((*_CLASSES, FrogSceneSettings))


def register() -> None:
    _register_classes()
    bpy.types.Scene.frog = PointerProperty(type=FrogSceneSettings)


def unregister() -> None:
    del bpy.types.Scene.frog
    _unregister_classes()
