"""Frames of a scene, rendered to image files."""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..capture.camera import Camera
from ..capture.video import write_image
from ..errors import UsageError, listed
from ..gaussians import NumpyGaussians
from ..scene.header import SceneHeader
from ..source_media.clips import camera_path
from .render import render_image

FrameRenderer = Callable[[int, Camera], NDArray[np.uint8]]
"""A frame (counted from 0) and a camera to an (H, W, 3) sRGB image."""


class PlayedFrames(Protocol):
    """What has frames: a scene, or one that is retimed."""

    @property
    def header(self) -> SceneHeader:
        """Of the scene's file."""

    @property
    def keeps_identity(self) -> bool:
        """See ``ScenePlayer``."""

    def at_frame(self, frame: int) -> NumpyGaussians:
        """Gaussians at a frame counted from 0."""


def cpu_renderer(scene: PlayedFrames) -> FrameRenderer:
    """Renders frames by the native library, without torch."""
    return lambda frame, camera: render_image(scene.at_frame(frame), camera, scene.header.background)


def render_frames(
    header: SceneHeader,
    camera_name: str,
    frames: Sequence[int],
    folder: Path,
    renderer: FrameRenderer,
    shown: Callable[[int], float] = float,
) -> Iterator[Path]:
    """Writes a PNG for each frame as one of a scene's cameras sees it; yields their paths as they are written.

    Args:
        camera_name: a camera of the scene. Of a moving camera each name is one pose, and "moving" follows its path.
        folder: made if it does not exist.
        renderer: renders the frames.
        shown: the capture's frame at each frame, where a renderer retimes them, for a camera that moves.

    Raises:
        FrogError: if there is no such camera, OpenCV is missing, or a file cannot be written.
    """
    camera_at = _camera_at(header, camera_name)
    name = re.sub(r'[/\\:*?"<>|]', "_", camera_name)  # without characters that lead to another folder on any system
    for frame in frames:
        path = folder / f"{name}_{frame:04d}.png"
        write_image(path, renderer(frame, camera_at(shown(frame))))
        yield path


def _camera_at(header: SceneHeader, name: str) -> Callable[[float], Camera]:
    """The camera of that name at each frame; FrogError where the scene has none."""
    if header.is_moving and name == "moving":
        path = dict(camera_path(header))
        # The nearest frame that has an image: captures may leave some out.
        return lambda frame: path[min(path, key=lambda known: abs(known - frame))]
    names = [camera.name for camera in header.cameras]
    if name not in names:
        raise UsageError(f"The scene has no camera {name!r}; its cameras: {listed(names)}.")
    fixed = header.cameras[names.index(name)]
    return lambda frame: fixed
