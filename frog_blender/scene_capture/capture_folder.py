"""The folder that a scene is rendered into: RGBA images of each camera, and ``transforms.json`` with exact cameras."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..engine.capture.camera import Camera
from ..engine.errors import FrogError, found_instead
from ..engine.io.atomic_files import write_atomically

LIST = "transforms.json"
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_DIGITS = 4


@dataclass(frozen=True)
class Plan:
    """What is rendered.

    Attributes:
        folder: of the capture.
        cameras: of the rig, each with a name of its own.
        frames: of the scene, ascending.
        rate: of those frames a second.
    """

    folder: Path
    cameras: tuple[Camera, ...]
    frames: tuple[int, ...]
    rate: float

    def image(self, camera: int, frame: int) -> Path:
        """The file of one image. Frames are numbered from the first, as a scene's may be negative."""
        number = frame - self.frames[0]
        return self.folder / self.cameras[camera].name / f"{number:0{_DIGITS}d}.png"

    @property
    def images(self) -> list[tuple[int, int, Path]]:
        """Camera, frame and file of every image, frame by frame: evaluating a frame costs more than turning to another
        camera.
        """
        cameras = range(len(self.cameras))
        return [(camera, frame, self.image(camera, frame)) for frame in self.frames for camera in cameras]

    @property
    def missing(self) -> list[tuple[int, int, Path]]:
        """Those of ``images`` that do not exist."""
        return [entry for entry in self.images if not entry[2].is_file()]


def prepare(plan: Plan) -> None:
    """Creates the folder and writes its list of images.

    Raises:
        FrogError: if there are images of another rig or of other frames, which must not be mixed with these, or
            something else; if nothing can be written.
    """
    text = _list(plan)
    file = plan.folder / LIST
    try:
        if file.is_file():
            if file.read_text(encoding="utf-8") != text:
                raise found_instead(file, "images of other cameras or frames", "an empty folder, or this rig's images")
        elif plan.folder.is_dir() and any(not entry.name.startswith(".") for entry in plan.folder.iterdir()):
            raise found_instead(plan.folder, "other files", "an empty folder, or images of this rig")
        for camera in plan.cameras:
            (plan.folder / camera.name).mkdir(parents=True, exist_ok=True)
        write_atomically(file, text.encode())
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FrogError(f"{plan.folder}: the capture cannot be written there ({reason}).") from error


def names_of(count: int) -> list[str]:
    """Names of a rig's cameras, which are names of folders as well."""
    digits = max(2, len(str(count - 1)))
    return [f"cam{index:0{digits}d}" for index in range(count)]


def _list(plan: Plan) -> str:
    """``transforms.json`` as nerfstudio has it: camera-to-world in OpenGL's axes, which are Blender's."""
    entries = []
    times = {frame: number / plan.rate for number, frame in enumerate(plan.frames)}
    for index, frame, path in plan.images:
        camera = plan.cameras[index]
        k = camera.intrinsics
        entries.append(
            {
                "file_path": path.relative_to(plan.folder).as_posix(),
                "time": times[frame],
                "w": camera.width,
                "h": camera.height,
                "fl_x": k[0, 0],
                "fl_y": k[1, 1],
                "cx": k[0, 2],
                "cy": k[1, 2],
                "transform_matrix": _rows(np.linalg.inv(camera.world_to_camera) @ _FLIP),
            }
        )
    top = {"camera_model": "PINHOLE", "fps": plan.rate, "frames": entries}
    return json.dumps(top, indent=1) + "\n"


def _rows(matrix: np.ndarray) -> Sequence[Sequence[float]]:
    rows: list[list[float]] = matrix.tolist()
    return rows
