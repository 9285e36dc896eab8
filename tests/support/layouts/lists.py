"""Lists in JSON: ``cameras_opencv.json``, and ``transforms.json`` with small grey images."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from frog_blender.engine.capture.camera import Camera

OPENGL_AHEAD = np.diag([1.0, -1.0, -1.0, 1.0])  # an OpenGL camera-to-world that looks along the world's +z, y down


def opencv_entry(camera: Camera, **own: Any) -> dict[str, Any]:
    """A camera as ``cameras_opencv.json`` lists it."""
    pose = {"R": camera.rotation.tolist(), "t": camera.world_to_camera[:3, 3].tolist()}
    size = {"width": camera.width, "height": camera.height}
    return {"name": camera.name, **size, "K": camera.intrinsics.tolist(), **pose, **own}


def write_opencv(folder: Path, entries: Iterable[dict[str, Any]], **top: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras_opencv.json").write_text(json.dumps({"cameras": list(entries), **top}))
    return folder


def posed(name: str, x: float, **own: Any) -> dict[str, Any]:
    """An image of a camera that stands at x and looks ahead."""
    pose = OPENGL_AHEAD.copy()
    pose[0, 3] = x
    return {"file_path": name, "transform_matrix": pose.tolist(), **own}


def posed_as(camera: Camera, name: str, **own: Any) -> dict[str, Any]:
    """An image of a camera."""
    pose = np.linalg.inv(camera.world_to_camera) @ OPENGL_AHEAD
    return {"file_path": name, "transform_matrix": pose.tolist(), **own}


def write_listed(
    folder: Path, files: Sequence[str], frames: list[dict[str, Any]], name: str = "transforms.json", **top: Any
) -> dict[str, Any]:
    """Images 40 x 30 whose grey is their place among ``files``, times 10, and a list; returns what it says."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, file in enumerate(files):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / file), np.full((30, 40, 3), 10 * index, np.uint8))
    data = {"fl_x": 50.0, "w": 40, "h": 30, "frames": frames, **top}
    (folder / name).write_text(json.dumps(data))
    return data


def write_moving(folder: Path, count: int = 10, name: str = "transforms.json", **top: Any) -> dict[str, Any]:
    """One camera, which moves along x."""
    names = [f"{name[:-5]}_{index:03d}" for index in range(count)]
    frames = [posed(f"./{image}", index) for index, image in enumerate(names)]
    return write_listed(folder, [f"{image}.png" for image in names], frames, name, **top)


def rewrite(folder: Path, data: dict[str, Any]) -> None:
    (folder / "transforms.json").write_text(json.dumps(data))
