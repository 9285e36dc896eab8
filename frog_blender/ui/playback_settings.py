"""Settings on objects and cameras: what a capture plays and when, and a calibrated camera's properties."""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

import contextlib
from functools import partial
from typing import Any

import bpy
from bpy.props import IntVectorProperty

from .. import capture_files
from ..engine.errors import FrogError
from ..properties import HIDDEN, choice, number, path, reference, switch, text, whole
from ..scene_import import camera_clips
from ..timeline import playback
from ..timeline.retiming import LAST_FRAME

REPETITIONS = (
    ("HOLD", "Hold", "Hold the first and the last frame"),
    ("LOOP", "Loop", "Start again from the first frame"),
    ("PING_PONG", "Ping-Pong", "Play backwards, then forwards again"),
)


def _on_trim(settings: Any, context: bpy.types.Context) -> None:
    if settings.use_trim and settings.last_frame == LAST_FRAME:
        with contextlib.suppress(FrogError):  # shown by the panel
            settings.last_frame = playback.open_scene(playback.file_of(settings.id_data)).header.frame_count - 1
    camera_clips.synchronize_again(settings.id_data)
    playback.on_setting(settings, context)


def _keep_path(settings: Any, path: str) -> str:
    capture_files.point_at(settings, path)
    return path


def _transformed() -> dict[str, Any]:
    """Accessors that redirect ``filepath`` to a volume's path (see capture_files), while its stored value stays
    compatible.
    """
    if bpy.app.version >= (5, 0, 0):
        return {
            "get_transform": lambda settings, stored, _is_set: capture_files.shown_path(settings, stored),
            "set_transform": lambda settings, path, _stored, _is_set: _keep_path(settings, path),
        }
    return {
        "get": lambda settings: capture_files.shown_path(settings, settings.get("filepath", "")),
        "set": lambda settings, path: settings.__setitem__("filepath", _keep_path(settings, path)),
    }


_PLAYED: dict[str, Any] = {"update": playback.on_setting}
_FIXED: dict[str, Any] = {"options": set(), "update": playback.on_setting}  # which no key animates
_TRIMMED: dict[str, Any] = {"options": set(), "update": _on_trim}
_percentage = partial(whole, default=100, min=0, max=100, subtype="PERCENTAGE")


class FrogPlaybackSettings(bpy.types.PropertyGroup):
    """``Object.frog``: what a capture plays, and when."""

    attached_to = bpy.types.Object, "frog"

    filepath: path("Scene File", "The .frog file that this object plays", **_PLAYED, **_transformed())
    source: reference(
        "Source",
        "The data-block through which Blender makes the scene file's path relative, finds it and packs it",
        bpy.types.Volume,
        options=HIDDEN,
    )
    start_frame: number(
        "Start Frame", "Frame of the timeline at which the capture's first frame is shown", 1.0, **_PLAYED
    )
    speed: number(
        "Speed",
        "Frames of the capture for each frame of the timeline. Negative values play backwards",
        1.0,
        soft_min=-4.0,
        soft_max=4.0,
        **_PLAYED,
    )
    repeat: choice(
        "At the End", "What to show before the capture's first and after its last frame", REPETITIONS, "HOLD", **_PLAYED
    )
    use_remap: switch(
        "Time Remapping",
        "Show the frame given below, which can be animated, instead of following the timeline",
        **_PLAYED,
    )
    use_trim: switch("Trim", "Play a piece of the capture alone", **_TRIMMED)
    first_frame: whole(
        "First Frame", "First frame of the piece, counted from zero; it is shown at the Start Frame", min=0, **_TRIMMED
    )
    last_frame: whole("Last Frame", "Last frame of the piece, counted from zero", LAST_FRAME, min=0, **_TRIMMED)
    use_range: switch("Limit", "Show the capture in a range of the timeline alone", **_FIXED)
    range_start: number("From", "First frame of the timeline at which the capture is there", 1.0, **_FIXED)
    range_end: number("Until", "First frame of the timeline after that at which it is not", 251.0, **_FIXED)
    sound: reference(
        "Sound",
        "The sound that was made of the capture's video for its strip",
        bpy.types.Sound,
        options=HIDDEN,
    )
    laid_over: switch(
        "Laid Over",
        "Excluded from other engines' renders because the compositor overlays FRoG's image of it",
        options=HIDDEN,
    )
    is_proxy: switch("Proxy Mesh", "This is the proxy mesh of the capture that its parent moves", options=HIDDEN)
    proxy_of: reference("Proxy Of", "The capture that this is a proxy mesh of", bpy.types.Object, options=HIDDEN)
    density: _percentage(
        "Density",
        "Share of the Gaussians that the viewport's points show: the most important ones, the same at "
        "every frame. Fewer scrub faster. FRoG's own renders always show all of them",
        **_PLAYED,
    )
    render_density: _percentage(
        "Density in Renders",
        "Share of the Gaussians that renders of engines other than FRoG show. With a window it requires Render > Lock "
        "Interface, which Set Up Scene enables; otherwise renders use the viewport's density",
    )
    shown_frame: number(
        "Shown Frame", "The capture's frame to show, counted from zero. Fractions lie between its frames", **_PLAYED
    )


class FrogCameraSettings(bpy.types.PropertyGroup):
    """``Camera.frog``: properties of a calibrated camera that a Blender camera lacks."""

    attached_to = bpy.types.Camera, "frog"

    focal_ratio: number(
        "Focal Ratio",
        "Vertical divided by horizontal focal length. The FRoG engine uses it, other engines assume one",
        1.0,
        min=0.01,
        max=100.0,
        precision=5,
    )
    size: IntVectorProperty(
        name="Image Size",
        description="Width and height in pixels of the captured images. Zero for a camera that was added by hand",
        size=2,
        min=0,
    )
    capture_camera: text(
        "Capture Camera",
        "Name of this camera in the capture, whatever it is called here. Empty for a camera that was added by hand",
    )
    rig_camera: text(
        "Rig Camera",
        "Name of the object that a rig placed with this camera, so that its copies are told apart. Empty for a camera "
        "that was added by hand",
        options=HIDDEN,
    )
