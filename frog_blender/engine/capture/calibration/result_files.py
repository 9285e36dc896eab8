"""``cameras_opencv.json`` of a calibration: never over a file that is there."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ..readers import layout_of
from .calibration import Calibration
from .films import Film

CAMERAS = "cameras_opencv.json"
"""The name under which readers look for cameras."""
_FOUND = "cameras_found"


def write_cameras(folder: Path, calibration: Calibration, films: Sequence[Film]) -> Path:
    """Writes the cameras, with each film's clock and path, and returns the file.

    It is CAMERAS in a folder without a calibration. Beside one that was given it is ``cameras_found.json``, or that
    with a number, unless a file of that name holds the same.

    Raises:
        FrogError: if it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps(_plain(folder, calibration, films), indent=1).encode()
    path = free_path(folder, CAMERAS, _FOUND, content, given=is_calibrated(folder))
    if not path.exists():
        write_atomically(path, content)
    return path


def is_calibrated(folder: Path) -> bool:
    """Whether a reader knows this very folder as a capture already, whatever lies in the folders below it."""
    try:
        return layout_of(folder) is not None
    except FrogError:
        return False


def free_path(folder: Path, name: str, other: str, content: bytes, *, given: bool) -> Path:
    """The file to write ``content`` to, or one that holds it already.

    Args:
        name: of the file in a folder that nobody calibrated.
        other: what it is called instead, without its ending, where ``name`` or another calibration was ``given``.
    """
    suffix = Path(name).suffix
    candidates = [folder / name, *(folder / f"{other}{'' if i < 2 else f'_{i}'}{suffix}" for i in range(1, 1000))]
    for candidate in candidates:
        if candidate.is_file() and candidate.read_bytes() == content:
            return candidate
    free = [path for path in candidates if not os.path.lexists(path)]
    return free[0] if not given else next(path for path in free if path.name != name)


def _plain(folder: Path, calibration: Calibration, films: Sequence[Film]) -> JsonObject:
    cameras = []
    for found, film in zip(calibration.cameras, films, strict=True):
        camera = found.camera
        entry: JsonObject = {
            "name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "K": camera.intrinsics.tolist(),
            "dist": [*found.distortion, 0.0, 0.0] if any(found.distortion) else [],
            "R": camera.rotation.tolist(),
            "t": camera.world_to_camera[:3, 3].tolist(),
        }
        if film.path.parent.resolve() != folder.resolve():
            entry["video"] = _path_from(folder, film.path)
        if (film.offset, film.rate) != (0.0, 1.0):
            entry |= {"offset": film.offset, "rate": film.rate}
        cameras.append(entry)
    return {"made_by": "frog calibrate", "cameras": cameras, "points": np.round(calibration.points, 4).tolist()}


def _path_from(folder: Path, video: Path) -> str:
    """Relative to the calibration's folder where both lie on one disk, so that they can move together."""
    try:
        return Path(os.path.relpath(video.resolve(), folder.resolve())).as_posix()
    except ValueError:  # two drives of Windows
        return str(video.resolve())
