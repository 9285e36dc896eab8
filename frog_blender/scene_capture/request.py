"""What is to be rendered: a rig's cameras and a scene's frames, and the process that renders them."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

from ..cameras import engine_camera
from ..engine.errors import FrogError
from ..timeline.retiming import frame_rate
from . import placing
from .capture_folder import Plan, names_of

_LENS = ("sensor_fit", "sensor_width", "sensor_height", "lens", "shift_x", "shift_y", "clip_start", "clip_end")
_SQUARE = SimpleNamespace(pixel_aspect_x=1.0, pixel_aspect_y=1.0)
_MAX_IMAGES = 200_000
_CHILD = Path(__file__).with_name("child.py")


@dataclass(frozen=True)
class RenderRequest:
    """A capture to render.

    Attributes:
        scene: its name, in the copy as well.
        plan: images and exact cameras.
        lenses: Blender's settings of each camera.
        matrices: (4, 4) of each camera, nested lists.
    """

    scene: str
    plan: Plan
    lenses: tuple[dict[str, Any], ...]  # Any: text or numbers, by Blender's names
    matrices: tuple[list[list[float]], ...]

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
        camera = self.plan.cameras[0]
        lenses = zip(self.lenses, self.matrices, strict=True)
        content = {
            "blend": str(blend),
            "scripts": scripts,
            "scene": self.scene,
            "size": [camera.width, camera.height],
            "cameras": [{"lens": lens, "matrix": matrix} for lens, matrix in lenses],
            "images": [[index, frame, str(file)] for index, frame, file in self.plan.missing],
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
    eyes = placing.cameras_of(settings)
    if not eyes:
        raise FrogError("The rig has no cameras, expected at least one. Press Place Cameras.")
    frames = tuple(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    if len(eyes) * len(frames) > _MAX_IMAGES:
        sentence = f"Found {len(eyes):,} cameras and {len(frames):,} frames, expected at most {_MAX_IMAGES:,} images."
        raise FrogError(f"{sentence} Shorten the scene's frame range or raise its step.")
    cameras, lenses, matrices = [], [], []
    for eye, name in zip(eyes, names_of(len(eyes)), strict=True):
        if eye.data.type != "PERSP":
            raise FrogError(f"Camera {eye.name}: found a {eye.data.type.lower()} lens, expected a perspective one.")
        camera = engine_camera(eye, eye.matrix_world, _SQUARE, settings.size, settings.size)
        cameras.append(replace(camera, name=name))
        lenses.append({key: getattr(eye.data, key) for key in _LENS})
        matrices.append([list(row) for row in eye.matrix_world])
    rate = frame_rate(scene) / scene.frame_step
    plan = Plan(folder_of(settings), tuple(cameras), frames, rate)
    return RenderRequest(scene.name, plan, tuple(lenses), tuple(matrices))


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
