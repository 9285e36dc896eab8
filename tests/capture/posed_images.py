"""Folders of posed images, written by the tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

OPENGL_AHEAD = np.diag([1.0, -1.0, -1.0, 1.0])  # an OpenGL camera-to-world that looks along the world's +z, y down


def write(folder: Path, count: int = 10, name: str = "transforms.json", **top: Any) -> dict[str, Any]:
    """Images 40 x 30 and their list; the camera moves along x."""
    folder.mkdir(parents=True, exist_ok=True)
    frames = []
    for index in range(count):
        file = f"{name[:-5]}_{index:03d}"
        cv2.imwrite(str(folder / f"{file}.png"), np.full((30, 40, 3), 10 * index, np.uint8))
        pose = OPENGL_AHEAD.copy()
        pose[0, 3] = index
        frames.append({"file_path": f"./{file}", "transform_matrix": pose.tolist()})
    data = {"fl_x": 50.0, "w": 40, "h": 30, "frames": frames, **top}
    (folder / name).write_text(json.dumps(data))
    return data


def rewrite(folder: Path, data: dict[str, Any]) -> None:
    (folder / "transforms.json").write_text(json.dumps(data))
