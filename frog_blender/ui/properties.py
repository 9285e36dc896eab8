"""What FRoG stores in a .blend file: settings of training on the scene, of playing on objects and cameras."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from .. import carrier, ellipsoid_nodes, playback

RECIPES = (
    ("draft", "Draft", "A first look: 3,500 steps or more, a minute or two on a processor"),
    ("standard", "Standard", "The usual choice: 10,000 steps or more, five to thirty minutes on a processor"),
    ("paper", "Paper", "The settings of the FRoG paper: 80,000 steps of a larger model, many hours"),
)


CAPACITIES = (
    ("auto", "Automatic", "No more than the scene needs: what stands still gets no motion, files stay small"),
    ("fixed", "Fixed", "Every Gaussian can move, and every number is kept as it is"),
)


DISPLAYS = (
    ("POINTS", "Splats", "Soft Gaussians, as near to the truth as other engines can draw them"),
    ("ELLIPSOIDS", "Ellipsoids", "A solid ellipsoid for each Gaussian, up to 50,000: to see what a scene is made of"),
)


REPETITIONS = (
    ("HOLD", "Hold", "The first and the last frame stay"),
    ("LOOP", "Loop", "The capture begins again"),
    ("PING_PONG", "Ping-Pong", "The capture plays backwards, then forwards again"),
)


_PATH_OPTIONS = {"ANIMATABLE", "PATH_SUPPORTS_BLEND_RELATIVE"}  # the latter lets a path begin at the .blend's folder


def _on_capture_folder(settings: Any, _context: Any) -> None:
    from . import capture_summary, preferences  # imports the readers, so not before someone names a folder

    preferences.add_environment()  # OpenCV, which reads videos, may be there
    capture_summary.inspect(bpy.path.abspath(settings.capture_folder))
    if not settings.output_path and settings.capture_folder:
        settings.output_path = bpy.path.abspath(settings.capture_folder).rstrip("/\\") + ".frog"


def _on_display(settings: Any, _context: Any) -> None:
    obj = settings.id_data
    too_many = settings.display == "ELLIPSOIDS" and carrier.count(obj) > ellipsoid_nodes.MOST
    if too_many:
        settings.display = "POINTS"  # comes back here
    else:
        carrier.display(obj, settings.display)


def _on_play_setting(_settings: Any, context: Any) -> None:
    playback.refresh(context.scene)


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
        options=_PATH_OPTIONS,
        update=_on_capture_folder,
    )
    output_path: StringProperty(
        name="Output",
        description="The .frog scene file that training writes",
        subtype="FILE_PATH",
        options=_PATH_OPTIONS,
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


class FrogPlaybackSettings(bpy.types.PropertyGroup):
    """``Object.frog``: what a capture plays, and when."""

    filepath: StringProperty(
        name="Scene File",
        description="The .frog file that this object plays",
        subtype="FILE_PATH",
        options=_PATH_OPTIONS,
        update=_on_play_setting,
    )
    start_frame: FloatProperty(
        name="Start Frame",
        description="Frame of the timeline at which the capture's first frame is shown",
        default=1.0,
        update=_on_play_setting,
    )
    speed: FloatProperty(
        name="Speed",
        description="Frames of the capture for each frame of the timeline; below zero it plays backwards",
        default=1.0,
        soft_min=-4.0,
        soft_max=4.0,
        update=_on_play_setting,
    )
    repeat: EnumProperty(
        name="At the End",
        description="What is shown before the capture's first and after its last frame",
        items=REPETITIONS,
        default="HOLD",
        update=_on_play_setting,
    )
    use_remap: BoolProperty(
        name="Time Remapping",
        description="Show the frame that is named below, which can be animated, instead of following the timeline",
        default=False,
        update=_on_play_setting,
    )
    display: EnumProperty(
        name="Display",
        description="How the viewport and other engines than FRoG show the Gaussians",
        items=DISPLAYS,
        default="POINTS",
        update=_on_display,
    )
    shown_frame: FloatProperty(
        name="Shown Frame",
        description="The capture's frame to show, counted from zero; fractions lie between its frames",
        default=0.0,
        update=_on_play_setting,
    )


class FrogCameraSettings(bpy.types.PropertyGroup):
    """``Camera.frog``: what a calibrated camera has and a Blender camera has not."""

    focal_ratio: FloatProperty(
        name="Focal Ratio",
        description="Vertical over horizontal focal length; the FROG engine honours it, other engines assume one",
        default=1.0,
        min=0.01,
        max=100.0,
        precision=5,
    )
    size: IntVectorProperty(
        name="Picture Size",
        description="Width and height in pixels of the pictures this camera took; zero for a camera made by hand",
        size=2,
        min=0,
    )


_CLASSES = (FrogTrainingSettings, FrogPlaybackSettings, FrogCameraSettings)
_OWNERS: dict[str, Any] = {"Scene": FrogTrainingSettings, "Object": FrogPlaybackSettings, "Camera": FrogCameraSettings}


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    for owner, cls in _OWNERS.items():
        getattr(bpy.types, owner).frog = PointerProperty(type=cls)


def unregister() -> None:
    for owner in _OWNERS:
        del getattr(bpy.types, owner).frog
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
