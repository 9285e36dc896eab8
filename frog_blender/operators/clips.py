"""The capture's own videos behind its cameras, showing the moment that the capture shows.

Each camera gets its video, or its sequence of pictures, as a background image. Which picture it shows follows from
the capture's timing by a driver, whatever its start, speed, repetition or time remapping; the expression is one of
those that Blender evaluates without Python. Nothing is decoded until a picture is looked at.
"""

# mypy: disable-error-code="valid-type"

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from .. import playback
from ..engine.clips import Clip, capture_folders, find_clips
from ..engine.errors import FrogError
from .imported import cameras_of, chosen, stored_path

OPACITY = 0.5
_MARK = "frog_clip"  # of the images that this file loads
_TIMING = {
    "s": "frog.start_frame",
    "v": "frog.speed",
    "r": "frog.repeat",
    "m": "frog.use_remap",
    "w": "frog.shown_frame",
}


def add_clips(obj: Any, folder: Path | None = None, *, opacity: float = OPACITY, in_front: bool = False) -> int:
    """Put the videos of a capture behind its cameras and return how many cameras have one now.

    Args:
        obj: what plays the capture.
        folder: the capture's; by default where the .frog file says, or near that file.

    Raises:
        FrogError: if the .frog file cannot be read.
    """
    path = playback.file_of(obj)
    header = playback.open_scene(path).header
    folders = [folder] if folder is not None else capture_folders(header, path)
    clips = next((found for each in folders if (found := find_clips(header, each))), {})
    shown = 0
    for camera in cameras_of(obj):
        clip = clips.get(camera.data.frog.capture_camera or camera.name)
        if clip is None or camera.data.library is not None:
            continue
        background = clip_of(camera) or camera.data.background_images.new()
        try:
            background.image = _load(clip)
        except RuntimeError:  # no picture or video that Blender can open
            camera.data.background_images.remove(background)
            continue
        background.alpha = opacity
        background.display_depth = "FRONT" if in_front else "BACK"
        background.frame_method = "STRETCH"  # a capture's pictures fill its cameras' frames, rounded sizes included
        camera.data.show_background_images = True
        _synchronise(camera.data, background, clip, obj)
        shown += 1
    return shown


def clip_of(camera: Any) -> Any:
    """The background image of a camera object that shows what it filmed, or None."""
    images = camera.data.background_images
    return next((each for each in images if each.image is not None and _MARK in each.image), None)


def _load(clip: Clip) -> Any:
    image = bpy.data.images.load(str(clip.path), check_existing=True)
    image.filepath = stored_path(clip.path)
    if clip.kind == "SEQUENCE":
        image.source = "SEQUENCE"
    image[_MARK] = True
    return image


def _synchronise(data: Any, background: Any, clip: Clip, obj: Any) -> None:
    """Drive the number of the picture that is shown. Number n is offset n - 1 of a clip that is one frame long."""
    index = next(i for i, each in enumerate(data.background_images) if each == background)
    path = f"background_images[{index}].image_user.frame_offset"
    data.driver_remove(path)
    if clip.kind == "PICTURE":
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
    driver.expression = expression(clip)


def expression(clip: Clip) -> str:
    """The driver's expression: retiming.capture_frame, rounded to a picture, as an offset of the first one."""
    last = clip.count - 1
    if last < 1:
        return str(clip.first - 1)
    position, turn = "(frame-s)*v", 2 * last
    loop = f"fmod(fmod({position},{clip.count})+{clip.count},{clip.count})"
    there_and_back = f"{last}-abs({last}-fmod(fmod({position},{turn})+{turn},{turn}))"
    shown = f"w if m else {position} if r==0 else {loop} if r==1 else {there_and_back}"
    return f"floor(clamp({shown},0,{last})+.5)*{clip.step}+{clip.first - 1}"


class FROG_OT_add_clips(bpy.types.Operator):
    """Show each camera's own video behind what it sees, in time with the capture. Videos are shown as they were filmed:
    where a lens distorts, they differ from the capture, which is free of distortion"""

    bl_idname = "frog.add_clips"
    bl_label = "Show Clips"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(
        name="Capture Folder",
        description="The folder with the videos or pictures that the capture was trained from",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    opacity: FloatProperty(
        name="Opacity",
        description="How opaque the clips are",
        default=OPACITY,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    in_front: BoolProperty(
        name="In Front",
        description="Lay the clips over what the cameras see, to compare, instead of behind it",
        default=False,
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        cls.poll_message_set("Select a capture with cameras first.")
        obj = chosen(context)
        return obj is not None and bool(cameras_of(obj))

    def invoke(self, context: Any, event: Any) -> set[str]:
        obj = chosen(context)
        try:
            if add_clips(obj, opacity=self.opacity, in_front=self.in_front):
                return {"FINISHED"}
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: Any) -> set[str]:
        obj = chosen(context)
        folder = Path(bpy.path.abspath(self.directory)) if self.directory else None
        try:
            shown = add_clips(obj, folder, opacity=self.opacity, in_front=self.in_front)
        except FrogError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not shown:
            where = folder or "The capture's folder"
            names = ", ".join(camera.name for camera in cameras_of(obj)[:3])
            self.report({"ERROR"}, f"{where}: found no clip of {obj.name}, expected pictures of {names} and so on.")
            return {"CANCELLED"}
        self.report({"INFO"}, f"{shown} of {len(cameras_of(obj))} cameras show their clip.")
        return {"FINISHED"}


class FROG_OT_hide_clips(bpy.types.Operator):
    """Hide what the capture's cameras filmed"""

    bl_idname = "frog.hide_clips"
    bl_label = "Hide Clips"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return FROG_OT_add_clips.poll(context)

    def execute(self, context: Any) -> set[str]:
        for camera in cameras_of(chosen(context)):
            background = clip_of(camera)
            if background is not None and camera.data.library is None:
                index = next(i for i, each in enumerate(camera.data.background_images) if each == background)
                camera.data.driver_remove(f"background_images[{index}].image_user.frame_offset")
                camera.data.background_images.remove(background)
        return {"FINISHED"}


_CLASSES = (FROG_OT_add_clips, FROG_OT_hide_clips)
_register_classes, unregister = bpy.utils.register_classes_factory(_CLASSES)


def _revive() -> None:
    """Blender gives drivers up whose properties go, as ours do when the add-on is switched off; told anew, they run."""
    for data in getattr(bpy.data, "cameras", ()):  # no data can be reached while Blender starts
        for curve in data.animation_data.drivers if data.animation_data is not None and data.library is None else ():
            if any(variable.targets[0].data_path in _TIMING.values() for variable in curve.driver.variables):
                curve.driver.expression = str(curve.driver.expression)


def register() -> None:
    _register_classes()
    _revive()
