"""What is to be rendered: a rig's cameras and a scene's frames; the folder of their RGBA images with its
``transforms.json``; and the process that renders them.
"""

import json
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

from ..cameras import engine_camera, pose_of
from ..engine.capture.camera import Camera
from ..engine.errors import FrogError, found_instead, in_words
from ..engine.io.atomic_files import write_atomically
from ..timeline.retiming import frame_rate
from . import placing

_LENS = ("sensor_fit", "sensor_width", "sensor_height", "lens", "shift_x", "shift_y", "clip_start", "clip_end")
_SQUARE = SimpleNamespace(pixel_aspect_x=1.0, pixel_aspect_y=1.0)
_MAX_IMAGES = 200_000
_CHILD = Path(__file__).with_name("child.py")
_LIST = "transforms.json"


@dataclass(frozen=True)
class RenderRequest:
    """A capture to render.

    Attributes:
        scene: its name, in the copy as well.
        folder: of the capture.
        cameras: of the rig, each with a name of its own.
        eyes: of each camera Blender's settings of its ``lens``, and its ``matrix`` (4, 4) as nested lists.
        frames: of the scene, ascending.
        rate: of those frames a second.
    """

    scene: str
    folder: Path
    cameras: tuple[Camera, ...]
    eyes: tuple[dict[str, Any], ...]  # Any: as JSON holds it
    frames: tuple[int, ...]
    rate: float

    @property
    def images(self) -> list[tuple[int, int, Path]]:
        """Camera, frame and file of every image, frame by frame: evaluating a frame costs more than turning to another
        camera. Files are numbered from the first frame, as a scene's may be negative.
        """
        return [
            (index, frame, self.folder / camera.name / f"{frame - self.frames[0]:04d}.png")
            for frame in self.frames
            for index, camera in enumerate(self.cameras)
        ]

    @property
    def missing(self) -> list[tuple[int, int, Path]]:
        """Those of ``images`` that do not exist."""
        return [image for image in self.images if not image[2].is_file()]

    def prepare(self) -> None:
        """Creates the capture's folder and writes its list of images.

        Raises:
            FrogError: if there are images of another rig or of other frames, which must not be mixed with these, or
                something else; if nothing can be written.
        """
        text, file = json.dumps(self._transforms(), indent=1) + "\n", self.folder / _LIST
        with in_words(f"{self.folder}: the capture cannot be written there", kinds=(OSError, UnicodeDecodeError)):
            if file.is_file():
                if file.read_text(encoding="utf-8") != text:
                    expected = "an empty folder, or this rig's images"
                    raise found_instead(file, "images of other cameras or frames", expected)
            elif self.folder.is_dir() and any(not entry.name.startswith(".") for entry in self.folder.iterdir()):
                raise found_instead(self.folder, "other files", "an empty folder, or images of this rig")
            for camera in self.cameras:
                (self.folder / camera.name).mkdir(parents=True, exist_ok=True)
            write_atomically(file, text.encode())

    def _transforms(self) -> dict[str, Any]:
        """``transforms.json`` as nerfstudio has it: camera-to-world in OpenGL's axes, which are Blender's."""
        times = {frame: index / self.rate for index, frame in enumerate(self.frames)}
        cameras: list[dict[str, Any]] = []
        for camera in self.cameras:
            k, size = camera.intrinsics, {"w": camera.width, "h": camera.height}
            lens = {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
            cameras.append({**size, **lens, "transform_matrix": pose_of(camera).tolist()})
        entries = []
        for index, frame, path in self.images:
            file = path.relative_to(self.folder).as_posix()
            entries.append({"file_path": file, "time": times[frame], **cameras[index]})
        return {"camera_model": "PINHOLE", "fps": self.rate, "frames": entries}

    def write(self, folder: Path, *, scripts: bool) -> Path:
        """Saves a copy of the open file, and the request for the child, in a temporary folder; the request's path.

        Args:
            scripts: whether the file's own scripts and drivers may run, as they do here.

        Raises:
            FrogError: if they cannot be saved.
        """
        blend, path = folder / "scene.blend", folder / "request.json"
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True, check_existing=False)
        except RuntimeError as error:
            raise FrogError(f"{blend}: the scene's copy could not be saved ({error}).") from error
        content = {
            "blend": str(blend),
            "scripts": scripts,
            "scene": self.scene,
            "size": [self.cameras[0].width, self.cameras[0].height],
            "cameras": self.eyes,
            "images": [[index, frame, str(file)] for index, frame, file in self.missing],
        }
        path.write_text(json.dumps(content), encoding="utf-8")
        return path


def request_of(scene: bpy.types.Scene, settings: Any) -> RenderRequest:
    """The capture that a scene's settings describe.

    Args:
        settings: ``Scene.frog.rig``.

    Raises:
        FrogError: without cameras or a folder, for a lens that cannot be trained from, or for too many images.
    """
    objects = placing.cameras_of(settings)
    if not objects:
        raise FrogError("The rig has no cameras, expected at least one. Press Place Cameras.")
    frames = tuple(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    if len(objects) * len(frames) > _MAX_IMAGES:
        found = f"Found {len(objects):,} cameras and {len(frames):,} frames, expected at most {_MAX_IMAGES:,} images."
        raise FrogError(f"{found} Shorten the scene's frame range or raise its step.")
    cameras, eyes, digits = [], [], max(2, len(str(len(objects) - 1)))
    for index, obj in enumerate(objects):
        if obj.data.type != "PERSP":
            raise FrogError(f"Camera {obj.name}: found a {obj.data.type.lower()} lens, expected a perspective one.")
        camera = engine_camera(obj, obj.matrix_world, _SQUARE, settings.size, settings.size)
        cameras.append(replace(camera, name=f"cam{index:0{digits}d}"))  # the name of a folder as well
        lens = {key: getattr(obj.data, key) for key in _LENS}
        eyes.append({"lens": lens, "matrix": [list(row) for row in obj.matrix_world]})
    rate = frame_rate(scene) / scene.frame_step
    return RenderRequest(scene.name, folder_of(settings), tuple(cameras), tuple(eyes), frames, rate)


def folder_of(settings: Any) -> Path:
    """The folder that the settings name; FrogError if that is none."""
    if not settings.folder or (settings.folder.startswith("//") and not bpy.data.filepath):
        raise FrogError("The capture has no folder yet. Choose one, or save the .blend that it is to lie beside.")
    return Path(os.path.normpath(bpy.path.abspath(settings.folder)))


def command(request: Path, *, scripts: bool) -> list[str]:
    """The process that renders a request: this Blender in the background, or Python where bpy is a module."""
    if getattr(bpy.app, "module", False):
        return [sys.executable, "-P", str(_CHILD), "--", str(request)]
    trust = "--enable-autoexec" if scripts else "--disable-autoexec"
    begin = [bpy.app.binary_path, "--background", "-noaudio", trust, str(request.with_name("scene.blend"))]
    return [*begin, "--python-exit-code", "1", "--python", str(_CHILD), "--", str(request)]
