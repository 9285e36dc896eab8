"""EasyVolcap, EasyMocap, 4K4D and ENeRF: ``intri.yml``, ``extri.yml`` and ``images/NAME/000000.jpg`` or films.

Of a camera NAME in ``names``: ``K_NAME`` (3 x 3, pixels), ``D_NAME`` or ``dist_NAME`` (k1 k2 p1 p2 k3), ``H_NAME``
and ``W_NAME`` (optional), ``Rot_NAME`` (3 x 3) or ``R_NAME`` (rotation vector), ``T_NAME``: world to camera in
OpenCV's axes. (zju3dv/EasyVolcap, easyvolcap/utils/easy_utils.py; zju3dv/EasyMocap.)

Nothing is held out. Masks are not used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ..camera import Camera, rotation_about
from ..capture import Capture
from .assembly import standing_cameras
from .checks import pinhole, rotation, size
from .footage import MAX_CAMERAS, Calibrated, Footage, find_below, natural, of_cameras, on_common_frames
from .geometry import distortion
from .opencv_yaml import OpencvYaml

_INTRINSICS, _EXTRINSICS = "intri.yml", "extri.yml"
_CALIBRATIONS = (".", "optimized", "calib")
_FOOTAGE = ("images", "videos", ".")


def matches(path: Path) -> bool:
    """True if the folder holds ``intri.yml``, here or below."""
    return any((path / folder / _INTRINSICS).is_file() for folder in _CALIBRATIONS)


def read(path: Path) -> Capture:
    """Open a folder of EasyVolcap's.

    Raises:
        FrogError: if ``extri.yml`` or all footage is missing, or a value cannot be used.
    """
    folder = next(path / calibration for calibration in _CALIBRATIONS if (path / calibration / _INTRINSICS).is_file())
    if not (folder / _EXTRINSICS).is_file():
        raise found_instead(folder, f"{_INTRINSICS} and no {_EXTRINSICS}", "both: the cameras' lenses and their poses")
    inner, outer = OpencvYaml(folder / _INTRINSICS), OpencvYaml(folder / _EXTRINSICS)
    names = inner.names("names") or [key[2:] for key in inner.keys if key.startswith("K_")]
    if not names or len(names) > MAX_CAMERAS or len(set(names)) < len(names):
        found = f"{len(names)} cameras" if names else "no camera"
        raise found_instead(inner.path, found, "names, each with a K_NAME")
    footage, warnings = of_cameras(inner.path, names, find_below(path, _FOOTAGE))
    names = sorted(footage, key=natural)
    shown = [footage[name] for name in names]
    sizes = _sizes(path, inner, names, shown)
    cameras = [_camera(name, size, inner, outer) for name, size in zip(names, sizes, strict=True)]
    return standing_cameras(path, "easyvolcap", cameras, shown, warnings)


def _sizes(path: Path, inner: OpencvYaml, names: list[str], footage: list[Footage]) -> list[tuple[int, int]]:
    """Width and height that each camera was calibrated at: its images', where the file does not say it."""
    known = [(inner.number(f"W_{name}") or 0, inner.number(f"H_{name}") or 0) for name in names]
    if all(min(each) > 0 for each in known):
        return [
            (size(width, inner.path, f"W_{name}"), size(height, inner.path, f"H_{name}"))
            for name, (width, height) in zip(names, known, strict=True)
        ]
    return list(on_common_frames(path, footage).sizes)


def _camera(name: str, size: tuple[int, int], inner: OpencvYaml, outer: OpencvYaml) -> Calibrated:
    matrix = pinhole(inner.matrix(f"K_{name}"), inner.path, f"K_{name}")
    pose = np.eye(4)
    pose[:3, :3] = _turn(name, outer)
    shift = outer.matrix(f"T_{name}")
    if shift.size != 3:
        raise found_instead(outer.path, f"{shift.size} numbers in T_{name}", "3")
    pose[:3, 3] = shift.ravel()
    key = next((each for each in (f"D_{name}", f"dist_{name}") if each in inner), None)
    coefficients = inner.matrix(key).ravel() if key else np.zeros(5)
    if coefficients.size not in (4, 5, 8, 12, 14):  # what OpenCV takes
        raise found_instead(inner.path, f"{coefficients.size} numbers in {key}", "4, 5, 8, 12 or 14")
    return Camera(name, *size, matrix, pose), distortion(coefficients)


def _turn(name: str, outer: OpencvYaml) -> Float64s:
    """(3, 3) world to camera."""
    for key in (f"Rot_{name}", f"R_{name}"):
        if key in outer:
            value = outer.matrix(key)
            if value.shape == (3, 3):
                return rotation(value, outer.path, key)
            if value.size != 3 or np.abs(value).max() > 100:
                raise found_instead(outer.path, f"{key} of {value.shape[0]} x {value.shape[1]}", "3 x 3 or 3 x 1")
            return rotation_about(value.ravel())
    raise found_instead(outer.path, f"no rotation of camera {name}", f"Rot_{name} or R_{name}")
