"""The videos of a capture as background images of its cameras, synchronized with the capture.

Each camera gets its video, its sequence of images, or the film that ``engine.source_media.undistorted_clips`` wrote
for it, as a background image. Which image it shows follows from the capture's timing by a driver, whatever its start,
speed, repetition or time remapping; the expression is one of those that Blender evaluates without Python. Nothing is
decoded until an image is looked at.
"""

import os
from pathlib import Path

import bpy

from .. import addon_state
from ..capture_files import named_file
from ..engine.errors import FrogError
from ..engine.scene.header import SceneHeader
from ..engine.source_media.clips import Clip, capture_folders, find_clips
from ..engine.source_media.undistorted_clips import Undistortion, undistorted_clips, undistortion
from ..timeline import playback
from ..timeline.retiming import TIMING, piece
from .capture_objects import cameras_of, stored_path

_OPACITY = 0.5
_MARK = "frog_clip"
"""Of the images that this file loads, which captures may share, and of a camera that shows one: first number, step and
count of the clip."""
_TIMING = dict(zip("svrmw", TIMING, strict=True))  # variables of drivers


class ClipsBeingWritten(set[Path]):
    """The folders of scenes whose undistorted clips an operator writes just now."""


def add_clips(
    obj: bpy.types.Object,
    folder: Path | None = None,
    *,
    in_front: bool = False,
    straight: bool = True,
) -> int:
    """Show the videos of a capture as backgrounds of its cameras. Returns the number of cameras that have one now.

    Args:
        obj: what plays the capture.
        folder: the capture's; by default where the .frog file says, or near that file.
        straight: show the films without distortion where there are such.

    Raises:
        FrogError: if the .frog file cannot be read.
    """
    path, header, folders = _sources(obj, folder)
    clips = next((of_folder for folder in folders if (of_folder := find_clips(header, folder))), {})
    if straight:
        clips |= undistorted_clips(header, path)
    shown = 0
    for camera in cameras_of(obj):
        clip = clips.get(camera.data.frog.capture_camera or camera.name)
        if clip is None or camera.data.library is not None:
            continue
        background = clip_of(camera) or camera.data.background_images.new()
        try:
            background.image = load_image(clip)
        except RuntimeError:  # no image or video that Blender can open
            camera.data.background_images.remove(background)
            continue
        background.alpha = _OPACITY
        background.display_depth = "FRONT" if in_front else "BACK"
        background.frame_method = "STRETCH"  # a capture's images fill its cameras' frames, rounded sizes included
        camera.data.show_background_images = True
        _synchronize(camera.data, background, clip, obj)
        shown += 1
    return shown


def begin_undistortion(obj: bpy.types.Object, folder: Path | None = None) -> Undistortion | None:
    """The undistorted clips that must be written for ``add_clips``; None if there are none, or no camera to show one.

    Raises:
        FrogError: if the .frog file cannot be read, or no capture of it be opened.
    """
    path, header, folders = _sources(obj, folder)
    if all(camera.data.library is not None for camera in cameras_of(obj)):
        return None
    problem = None
    for candidate in filter(os.path.isdir, folders):  # False for invalid names
        try:
            return undistortion(header, path, candidate, writing=addon_state.get(ClipsBeingWritten))
        except FrogError as error:
            problem = problem or error
    if problem is not None:
        raise problem
    return None


def _sources(obj: bpy.types.Object, folder: Path | None) -> tuple[Path, SceneHeader, list[Path]]:
    """The file that an object plays, its header, and the folders where the capture may be."""
    path = named_file(obj)  # clips of a packed file are next to its original path
    header = playback.open_scene(playback.file_of(obj)).header
    return path, header, [folder] if folder is not None else capture_folders(header, path)


def clip_of(camera: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """The background image of a camera object that shows its clip, or None."""
    images = camera.data.background_images
    return next((image for image in images if image.image is not None and _MARK in image.image), None)


def load_image(clip: Clip) -> bpy.types.Image:
    """The image data-block of a clip, the add-on's own; RuntimeError for what Blender cannot open."""
    path = os.path.normpath(clip.path)
    ours = (image for image in bpy.data.images if _MARK in image and image.library is None)
    known = next((image for image in ours if os.path.normpath(bpy.path.abspath(image.filepath)) == path), None)
    # Never the user's own image of that file.
    image = known if known is not None else bpy.data.images.load(str(clip.path))
    image.filepath = stored_path(clip.path)
    image.reload()  # the file may have been rewritten
    if clip.kind == "SEQUENCE":
        image.source = "SEQUENCE"
    if _MARK not in image:
        image[_MARK] = True
    return image


def _synchronize(
    data: bpy.types.Camera, background: bpy.types.CameraBackgroundImage, clip: Clip, obj: bpy.types.Object
) -> None:
    """Drive the index of the shown image. Image n is offset n - 1 of a clip that is one frame long."""
    path = _offset_of(data, background)
    data.driver_remove(path)
    data[_MARK] = [clip.first, clip.step, clip.count]
    if clip.kind == "IMAGE":
        return
    user = background.image_user
    user.frame_start, user.frame_duration, user.use_auto_refresh = 1, 1, True
    user.use_cyclic = True  # or Blender hides a sequence after its only frame
    driver = data.driver_add(path).driver
    driver.type = "SCRIPTED"
    for name, data_path in _TIMING.items():
        variable = driver.variables.new()
        variable.name, variable.type = name, "SINGLE_PROP"
        variable.targets[0].id, variable.targets[0].data_path = obj, data_path
    driver.expression = _expression(obj, clip.first, clip.step, clip.count)


def _expression(obj: bpy.types.Object, first: int, step: int, count: int) -> str:
    """The driver's expression: retiming.capture_frame, rounded to an image, as an offset of the first one.

    Args:
        first: number of the image of the capture's first frame; ``step`` from there to the next one's.
        count: frames of the capture.
    """
    begin, played = piece(obj.frog, count)
    last, position = played - 1, "(frame-s)*v"
    loop = there_and_back = "0"
    if last:
        loop = f"fmod(fmod({position},{played})+{played},{played})"
        turn = 2 * last
        there_and_back = f"{last}-abs({last}-fmod(fmod({position},{turn})+{turn},{turn}))"
    shown = f"clamp({position} if r==0 else {loop} if r==1 else {there_and_back},0,{last})+{begin}"
    return f"floor((clamp(w,0,{count - 1}) if m else {shown})+.5)*{step}+{first - 1}"


def _offset_of(data: bpy.types.Camera, background: bpy.types.CameraBackgroundImage) -> str:
    """The path of the property that a clip's driver drives."""
    index = next(i for i, image in enumerate(data.background_images) if image == background)
    return f"background_images[{index}].image_user.frame_offset"


def _drivers_of(data: bpy.types.Camera) -> list[bpy.types.Driver]:
    """The drivers of a camera's clips; none of a linked one, which cannot be changed."""
    animation = data.animation_data if data.library is None else None
    drivers = [curve.driver for curve in animation.drivers] if animation is not None else []
    return [driver for driver in drivers if any(one.targets[0].data_path in TIMING for one in driver.variables)]


def synchronize_again(obj: bpy.types.Object) -> None:
    """Fits the clips of a capture's cameras to the piece of it that is played now."""
    for camera in cameras_of(obj):
        for driver in _drivers_of(camera.data) if _MARK in camera.data else ():
            driver.expression = _expression(obj, *camera.data[_MARK].to_list())


def hide_clip(camera: bpy.types.Object) -> None:
    """Remove a camera object's clip and its driver."""
    background = clip_of(camera)
    if background is not None and camera.data.library is None:
        camera.data.driver_remove(_offset_of(camera.data, background))
        camera.data.background_images.remove(background)
        camera.data.pop(_MARK, None)


def refresh_drivers() -> None:
    """Blender disables drivers whose properties were unregistered. Setting their expressions again enables them."""
    for data in getattr(bpy.data, "cameras", ()):  # no data can be reached while Blender starts
        for driver in _drivers_of(data):
            driver.expression = str(driver.expression)
