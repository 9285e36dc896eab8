"""Images and films of the scene on disk."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from support.filmed_scene import FRAMES, Rays, image
from support.small_captures import write_film

from frog_blender.engine.capture.camera import Camera


def write_image(path: Path, image: np.ndarray) -> Path:
    """A lossless file where the ending allows it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 100])
    return path


def write_frames(folder: Path, cameras: Sequence[Camera], pattern: str = "{name}/{frame:04d}.png") -> None:
    """The images of all frames; ``pattern`` may use name, camera (a number), frame, and ``one`` (the frame from 1)."""
    for index, camera in enumerate(cameras):
        for frame in range(FRAMES):
            name = pattern.format(name=camera.name, camera=index, frame=frame, one=frame + 1)
            write_image(folder / name, image(camera, frame))


def write_films(
    folder: Path,
    cameras: Sequence[Camera],
    pattern: str = "{name}.avi",
    rays: Callable[[Camera], Rays | None] = lambda _: None,
) -> None:
    for index, camera in enumerate(cameras):
        images = [image(camera, frame, rays(camera)) for frame in range(FRAMES)]
        write_film(folder / pattern.format(name=camera.name, camera=index), images, codec="FFV1")
