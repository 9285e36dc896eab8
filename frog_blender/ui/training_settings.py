"""What FRoG stores on a scene: what to train and how, and how FROG renders."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from .path_options import PATH_OPTIONS

RECIPES = (
    ("draft", "Draft", "A first look: 3,000 steps or more, a minute or two on a processor"),
    ("standard", "Standard", "The usual choice: 10,000 steps or more, five to thirty minutes on a processor"),
    ("paper", "Paper", "The settings of the FRoG paper: 80,000 steps of a larger model, many hours"),
)


CAPACITIES = (
    ("auto", "Automatic", "No more than the scene needs: what stands still gets no motion, files stay small"),
    ("fixed", "Fixed", "Every Gaussian can move, and every number is kept as it is"),
)


def _on_capture_folder(settings: Any, _context: Any) -> None:
    from . import capture_summary, preferences  # imports the readers, so not before someone names a folder

    preferences.add_environment()  # OpenCV, which reads videos, may be there
    capture_summary.inspect(bpy.path.abspath(settings.capture_folder))
    if not settings.output_path and settings.capture_folder:
        settings.output_path = bpy.path.abspath(settings.capture_folder).rstrip("/\\") + ".frog"


class FrogTrainingSettings(bpy.types.PropertyGroup):
    """``Scene.frog``: what to train and how, and how FROG renders."""

    hold_out: BoolProperty(
        name="Objects Hide Splats",
        description="Splats end where an object of this scene hides them; the objects themselves are not drawn",
        default=False,
    )

    capture_folder: StringProperty(
        name="Capture",
        description="Folder with the videos or pictures and the cameras that filmed them",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
        update=_on_capture_folder,
    )
    output_path: StringProperty(
        name="Output",
        description="The .frog scene file that training writes",
        subtype="FILE_PATH",
        options=PATH_OPTIONS,
    )
    recipe: EnumProperty(
        name="Recipe", description="How long and how large to train", items=RECIPES, default="standard"
    )
    capacity: EnumProperty(
        name="Capacity",
        description="How much of a model a scene gets",
        items=CAPACITIES,
        default="auto",
    )
    steps: IntProperty(
        name="Steps",
        description="Training steps; zero takes the recipe's own number",
        min=0,
        default=0,
    )
    image_scale: FloatProperty(
        name="Picture Scale",
        description="Train on pictures resized by this factor; zero shrinks only what is larger than 1600 pixels",
        min=0.0,
        max=1.0,
        default=0.0,
    )
    holdout_frames: IntProperty(
        name="Hold Out Every",
        description="Keep one of this many frames out of training, to measure quality on it; "
        "zero keeps none, -1 what the capture's layout says",
        min=-1,
        default=-1,
    )
    import_when_done: BoolProperty(
        name="Import When Done",
        description="Open the trained scene here as soon as it is finished",
        default=True,
    )


def register() -> None:
    bpy.utils.register_class(FrogTrainingSettings)
    bpy.types.Scene.frog = PointerProperty(type=FrogTrainingSettings)


def unregister() -> None:
    del bpy.types.Scene.frog
    bpy.utils.unregister_class(FrogTrainingSettings)
