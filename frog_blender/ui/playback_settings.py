"""What FRoG stores on objects and cameras: what a capture plays and when, what a calibrated camera has."""

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

from .. import capture_files, point_cloud, relative_paths
from ..nodes import ellipsoid_nodes
from ..timeline import playback
from .path_options import PATH_OPTIONS

DISPLAYS = (
    ("POINTS", "Splats", "Soft Gaussians, as near to the truth as other engines can draw them"),
    ("ELLIPSOIDS", "Ellipsoids", "A solid ellipsoid for each Gaussian, up to 50,000: to see what a scene is made of"),
)


REPETITIONS = (
    ("HOLD", "Hold", "The first and the last frame stay"),
    ("LOOP", "Loop", "The capture begins again"),
    ("PING_PONG", "Ping-Pong", "The capture plays backwards, then forwards again"),
)


def _on_display(settings: Any, context: Any) -> None:
    obj = settings.id_data
    too_many = settings.display == "ELLIPSOIDS" and point_cloud.count(obj) > ellipsoid_nodes.MOST
    if too_many:
        settings.display = "POINTS"  # comes back here
    else:
        point_cloud.display(obj, settings.display)
        playback.refresh(context.scene)


def _on_play_setting(_settings: Any, context: Any) -> None:
    if not relative_paths.are_being_written():
        playback.refresh(context.scene)


def _keep_path(settings: Any, path: str) -> str:
    capture_files.point_at(settings, path)
    return path


def _transformed() -> dict[str, Any]:
    """How ``filepath`` becomes the path of a volume (see capture_files) and stays stored as it always was."""
    if bpy.app.version >= (5, 0, 0):
        return {
            "get_transform": lambda settings, stored, _is_set: capture_files.shown_path(settings, stored),
            "set_transform": lambda settings, path, _stored, _is_set: _keep_path(settings, path),
        }
    return {
        "get": lambda settings: capture_files.shown_path(settings, settings.get("filepath", "")),
        "set": lambda settings, path: settings.__setitem__("filepath", _keep_path(settings, path)),
    }


class FrogPlaybackSettings(bpy.types.PropertyGroup):
    """``Object.frog``: what a capture plays, and when."""

    filepath: StringProperty(
        name="Scene File",
        description="The .frog file that this object plays",
        subtype="FILE_PATH",
        options=PATH_OPTIONS,
        update=_on_play_setting,
        **_transformed(),
    )
    source: PointerProperty(
        name="Source",
        description="What Blender knows the scene file by, to make its path relative, to find it and to pack it",
        type=bpy.types.Volume,
        options={"HIDDEN"},
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
    laid_over: BoolProperty(
        name="Laid Over",
        description="Left out of other engines' renders, because the compositor lays FRoG's image of it over them",
        default=False,
        options={"HIDDEN"},
    )
    bake_folder: StringProperty(
        name="Bake Folder",
        description="Where the baked playback of this capture lies; empty for beside the .frog file",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
        update=_on_play_setting,
    )
    bake_megabytes: IntProperty(
        name="Largest Bake (MB)",
        description="Bake Playback refuses to write more than this to the disk",
        default=4096,
        min=1,
        soft_max=262_144,
    )
    display: EnumProperty(
        name="Display",
        description="How the viewport and other engines than FRoG show the Gaussians",
        items=DISPLAYS,
        default="POINTS",
        update=_on_display,
    )
    density: IntProperty(
        name="Density",
        description="How many of the Gaussians the viewport's points or ellipsoids show: the most important ones, the "
        "same at every frame. Fewer scrub faster. What FRoG itself draws always has all of them",
        default=100,
        min=0,
        max=100,
        subtype="PERCENTAGE",
        update=_on_play_setting,
    )
    render_density: IntProperty(
        name="Density in Renders",
        description="How many of the Gaussians the renders of other engines than FRoG show. In windows it needs Lock "
        "Interface (menu Render), which importing a capture switches on; otherwise renders have the viewport's",
        default=100,
        min=0,
        max=100,
        subtype="PERCENTAGE",
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
        name="Image Size",
        description="Width and height in pixels of the images this camera took; zero for a camera made by hand",
        size=2,
        min=0,
    )
    capture_camera: StringProperty(
        name="Capture Camera",
        description="Which of the capture's cameras this is, whatever its name here; empty for a camera made by hand",
    )


_CLASSES = (FrogPlaybackSettings, FrogCameraSettings)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(_CLASSES)
_OWNERS: dict[str, Any] = {"Object": FrogPlaybackSettings, "Camera": FrogCameraSettings}


def register() -> None:
    _register_classes()
    for owner, cls in _OWNERS.items():
        getattr(bpy.types, owner).frog = PointerProperty(type=cls)


def unregister() -> None:
    for owner in _OWNERS:
        del getattr(bpy.types, owner).frog
    _unregister_classes()
