"""Settings on scenes: what to train, and how."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from pathlib import Path
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .. import redrawing, relative_paths
from ..engine.training.session.output_paths import free_output
from .path_options import PATH_OPTIONS
from .remote_settings import REMOTE
from .rig_settings import FrogRigSettings
from .training_choices import TrainingChoices

RECIPES = (
    ("draft", "Quick Look (Draft)", "A first look: at least 3,000 steps, a minute or two on a CPU"),
    (
        "standard",
        "Good (Standard)",
        "The usual choice: at least 10,000 steps, three to ten minutes on a CPU, longer for long captures",
    ),
    ("paper", "Final (Paper)", "The settings of the FRoG paper: 80,000 steps of a larger model, many hours"),
)


DEVICES = (
    ("auto", "Automatic", "The NVIDIA GPU if torch and FRoG can use one, otherwise the CPU"),
    ("cpu", "CPU", "All cores of the CPU"),
    ("cuda", "CUDA", "The NVIDIA GPU; needs a torch with CUDA"),
    (REMOTE, "Remote", "Another computer, by the Remote Command in the add-on's preferences"),
)


CAPACITIES = (
    ("auto", "Automatic", "As much as the scene needs: static parts get no motion, files stay small"),
    ("fixed", "Fixed", "Every Gaussian can move, and nothing is compressed"),
)


MASKS = (
    (
        "auto",
        "From the Folder",
        "Learn only what is opaque, or inside the folder's 'masks', and nothing inside those in 'ignore'",
    ),
    ("key", "Key Colour", "The same, and a backdrop of one colour is not learned"),
    ("off", "None", "Whole images are learned, whatever masks there are"),
)


def _on_capture_folder(settings: Any, _context: bpy.types.Context) -> None:
    if relative_paths.are_being_written():
        return
    from . import capture_reading  # imported late, as this imports the readers

    capture_reading.read(bpy.path.abspath(settings.capture_folder))
    if settings.capture_folder and settings.output_path in ("", settings.derived_output):
        folder = Path(bpy.path.abspath(settings.capture_folder))
        settings.derived_output = settings.output_path = str(free_output(Path(f"{folder}.frog"), folder))


def camera_names(settings: Any, _context: bpy.types.Context, text: str) -> list[str]:
    """Search suggestions for the preview camera."""
    from . import capture_summary

    summary = capture_summary.known(bpy.path.abspath(settings.capture_folder))
    return [name for name in summary.cameras if text.lower() in name.lower()] if summary else []


def _on_show_rig(_settings: Any, _context: bpy.types.Context) -> None:
    redrawing.viewports()


def _on_preview_camera(settings: Any, _context: bpy.types.Context) -> None:
    from ..tasks.training import TrainingTask

    task = TrainingTask.current()
    if task is not None:
        task.control.preview_camera = settings.preview_camera


class TrainingSettings(TrainingChoices):
    """A base of ``Scene.frog``: what to train, and how."""

    rig: PointerProperty(type=FrogRigSettings)

    capture_folder: StringProperty(
        name="Capture",
        description="Folder with the videos or images and their camera calibration",
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
        description="The output path derived from the capture's name. It follows the capture as long as the output "
        "is not changed by hand",
        options={"HIDDEN"},
    )
    recipe: EnumProperty(
        name="Quality", description="Length of the training and size of the model", items=RECIPES, default="standard"
    )
    device: EnumProperty(
        name="Device",
        description="The device that computes the training",
        items=DEVICES,
        default="auto",
    )
    preview_camera: StringProperty(
        name="Preview",
        description="Camera of the capture whose view is shown during training. Empty for the first held-out "
        "camera. It can be changed during training",
        search=camera_names,
        update=_on_preview_camera,
    )
    masks: EnumProperty(
        name="Masks",
        description="Which pixels of the images are learned",
        items=MASKS,
        default="auto",
    )
    key_color: FloatVectorProperty(
        name="Key Colour",
        description="Colour of the backdrop",
        subtype="COLOR_GAMMA",
        size=3,
        min=0.0,
        max=1.0,
        default=(0.0, 177 / 255, 64 / 255),
    )
    key_tolerance: FloatProperty(
        name="Tolerance",
        description="How much less of the key colour than its own a pixel of the backdrop may have, in shadows for "
        "example",
        min=0.0,
        max=0.95,
        default=0.4,
    )
    capacity: EnumProperty(
        name="Capacity",
        description="How much capacity the model of a scene gets",
        items=CAPACITIES,
        default="auto",
    )
    steps: IntProperty(
        name="Steps",
        description="Training steps. Zero for as many as the quality needs",
        min=0,
        default=0,
    )
    minutes: FloatProperty(
        name="Minutes",
        description="Time to train for, without reading the images and saving. Zero for a number of steps",
        min=0.0,
        soft_max=600.0,
        precision=1,
        step=50,
        default=0.0,
    )
    image_scale: FloatProperty(
        name="Image Scale",
        description="Resize the training images by this factor. Zero to resize only images larger than 1600 pixels",
        min=0.0,
        max=1.0,
        default=0.0,
    )
    holdout_frames: IntProperty(
        name="Hold Out Every",
        description="Hold out every n-th frame from training to measure quality on it. Zero for none, -1 for the "
        "capture format's default",
        min=-1,
        default=-1,
    )
    max_gaussians: IntProperty(
        name="Largest Number",
        description="The scene has this many splats at most. Zero for as many as the quality allows",
        min=0,
        soft_max=1_000_000,
        default=0,
    )
    pixel_offsets: StringProperty(
        name="Pixel Offset",
        description="For videos that were cropped after the calibration: the pixel of the calibrated image at a "
        "video's upper left corner, such as cam01=8,0 cam02=8,0",
    )
    show_rig: BoolProperty(
        name="Draw Rig",
        description="Draw the capture's cameras into the viewport until a scene of it is imported",
        default=True,
        update=_on_show_rig,
    )
    show_live: BoolProperty(
        name="Show in Viewports",
        description="Show the scene in the viewports while it is trained. It takes 2 % of the training's time",
        default=True,
        update=_on_show_rig,
    )
    import_when_done: BoolProperty(
        name="Import When Done",
        description="Import the trained scene into this one as soon as it is finished. Settings of a scene that you "
        "have changed are not touched",
        default=True,
    )
