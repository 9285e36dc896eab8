"""What FRoG stores on a scene: what to train and how, and how FROG renders."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from .. import relative_paths
from ..engine.training.session.output_paths import free_output
from .path_options import PATH_OPTIONS

RECIPES = (
    ("draft", "Draft", "A first look: 3,000 steps or more, a minute or two on a processor"),
    (
        "standard",
        "Standard",
        "The usual choice: 10,000 steps or more, three to ten minutes on a processor, longer for a long capture",
    ),
    ("paper", "Paper", "The settings of the FRoG paper: 80,000 steps of a larger model, many hours"),
)


DEVICES = (
    ("auto", "Automatic", "The NVIDIA GPU (experimental) where torch and FRoG can use one, else the processor"),
    ("cpu", "CPU", "The processor, with all its cores"),
    ("cuda", "CUDA (Experimental)", "The NVIDIA GPU; needs a torch with CUDA. It has not run on a GPU yet"),
)


CAPACITIES = (
    ("auto", "Automatic", "No more than the scene needs: what stands still gets no motion, files stay small"),
    ("fixed", "Fixed", "Every Gaussian can move, and every number is kept as it is"),
)


def _on_capture_folder(settings: Any, _context: Any) -> None:
    if relative_paths.are_being_written():
        return
    from . import capture_summary, preferences  # imports the readers, so not before someone names a folder

    preferences.add_environment()  # OpenCV, which reads videos, may be there
    capture_summary.inspect(bpy.path.abspath(settings.capture_folder))
    if settings.capture_folder and settings.output_path in ("", settings.derived_output):
        folder = Path(bpy.path.abspath(settings.capture_folder))
        settings.derived_output = settings.output_path = str(free_output(Path(f"{folder}.frog"), folder))


def camera_names(settings: Any, _context: Any, text: str) -> list[str]:
    """For the preview camera's search."""
    from . import capture_summary

    summary = capture_summary.known(bpy.path.abspath(settings.capture_folder))
    return [name for name in summary.cameras if text.lower() in name.lower()] if summary else []


def _on_preview_camera(settings: Any, _context: Any) -> None:
    from ..training_task import runner

    task = runner.current()
    if task is not None:
        task.control.preview_camera = settings.preview_camera


class FrogTrainingSettings(bpy.types.PropertyGroup):
    """``Scene.frog``: what to train and how, and how FROG renders."""

    hold_out: BoolProperty(
        name="Objects Hide Splats",
        description="Splats end where an object of this scene hides them; the objects themselves are not drawn",
        default=False,
    )
    composed_with: PointerProperty(
        name="Composed With",
        description="The scene of the user's objects that this one of captures was made for",
        type=bpy.types.Scene,
        options={"HIDDEN"},
    )

    set_up_as: StringProperty(
        name="Set Up As",
        description="The scene's settings as they were when FRoG set them up for a capture, to tell whether they are",
        options={"HIDDEN"},
    )

    capture_folder: StringProperty(
        name="Capture",
        description="Folder with the videos or images and the cameras that filmed them",
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
    derived_output: StringProperty(
        name="Derived Output",
        description="The output that the capture's name led to; another capture changes it as long as it stands",
        options={"HIDDEN"},
    )
    recipe: EnumProperty(
        name="Recipe", description="How long and how large to train", items=RECIPES, default="standard"
    )
    device: EnumProperty(
        name="Device",
        description="What computes the training; the same scene comes out of either",
        items=DEVICES,
        default="auto",
    )
    preview_camera: StringProperty(
        name="Preview",
        description="Camera of the capture whose view is shown while training; empty for the first that is held out. "
        "It can be changed while training",
        search=camera_names,
        update=_on_preview_camera,
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
        name="Image Scale",
        description="Train on images resized by this factor; zero shrinks only what is larger than 1600 pixels",
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
        description="Add the trained scene to this one as soon as it is finished. Settings of a scene that holds "
        "anything of yours stay as they are",
        default=True,
    )


def register() -> None:
    bpy.utils.register_class(FrogTrainingSettings)
    bpy.types.Scene.frog = PointerProperty(type=FrogTrainingSettings)


def unregister() -> None:
    del bpy.types.Scene.frog
    bpy.utils.unregister_class(FrogTrainingSettings)
