"""Small true-to-format captures, written by the tests themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

ViewportImage = Callable[[int], np.ndarray]


def write_video(path: Path, frames: int, width: int = 64, height: int = 48, image: ViewportImage | None = None) -> Path:
    """A video whose frame f is ``image(f)`` (H, W, 3 RGB), or grey of brightness 20 + 10 f."""
    codec = cv2.VideoWriter_fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
    writer = cv2.VideoWriter(str(path), codec, 30.0, (width, height))
    for frame in range(frames):
        drawn = np.full((height, width, 3), 20 + 10 * frame, np.uint8) if image is None else image(frame)
        writer.write(np.ascontiguousarray(drawn[..., ::-1]))
    writer.release()
    return path


def llff_row(height: int, width: int, focal: float, center: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """A row of poses_bounds.npy for a camera that looks along +z of the world with y down (OpenCV's axes)."""
    down, right, backwards = [0.0, 1, 0], [1.0, 0, 0], [0.0, 0, -1]
    matrix = np.stack([down, right, backwards, center, [height, width, focal]], axis=1)
    return np.concatenate([matrix.ravel(), [0.5, 20.0]])


def write_n3dv(folder: Path, names: tuple[str, ...] = ("cam00", "cam01", "cam03"), frames: int = 5) -> Path:
    """An N3DV capture; camera i stands at x = i."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        write_video(folder / f"{name}.mp4", frames)
    np.save(folder / "poses_bounds.npy", np.stack([llff_row(48, 64, 50.0, (i, 0, 0)) for i in range(len(names))]))
    return folder
