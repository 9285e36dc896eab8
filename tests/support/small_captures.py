"""Small true-to-format captures, written by the tests themselves."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from support.builders import plain_camera

from frog_blender.engine.capture.camera import Camera

ViewportImage = Callable[[int], np.ndarray]


def write_film(path: Path, images: Sequence[np.ndarray], rate: float = 30.0, codec: str = "") -> Path:
    """A film of images (H, W, 3) RGB; hardly compressed where it is an AVI, lossless with FFV1."""
    path.parent.mkdir(parents=True, exist_ok=True)
    codec = codec or ("MJPG" if path.suffix == ".avi" else "mp4v")
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate, (width, height))
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return path


def write_video(path: Path, frames: int, width: int = 64, height: int = 48, image: ViewportImage | None = None) -> Path:
    """A video whose frame f is ``image(f)`` (H, W, 3 RGB), or grey of brightness 20 + 10 f."""
    draw = image or (lambda frame: np.full((height, width, 3), 20 + 10 * frame, np.uint8))
    return write_film(path, [draw(frame) for frame in range(frames)])


def llff_rows(cameras: Iterable[Camera], near: float = 0.5, far: float = 20.0) -> np.ndarray:
    """What poses_bounds.npy says of cameras."""
    rows = []
    for camera in cameras:
        right, down, forward = camera.rotation
        shape = [camera.height, camera.width, camera.intrinsics[0, 0]]
        rows.append([*np.stack([down, right, -forward, camera.center, shape], axis=1).ravel(), near, far])
    return np.array(rows)


def llff_row(height: int, width: int, focal: float, center: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """A row of it for a camera that looks along +z of the world with y down (OpenCV's axes)."""
    return llff_rows([plain_camera(width, height, focal).moved(np.zeros(3), -np.array(center))])[0]


def write_n3dv(folder: Path, names: tuple[str, ...] = ("cam00", "cam01", "cam03"), frames: int = 5) -> Path:
    """An N3DV capture; camera i stands at x = i."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        write_video(folder / f"{name}.mp4", frames)
    np.save(folder / "poses_bounds.npy", np.stack([llff_row(48, 64, 50.0, (i, 0, 0)) for i in range(len(names))]))
    return folder
