"""Films and a TOML calibration as caliscope, anipose, freemocap and Pose2Sim write it.

A table for each camera (in caliscope's file below ``cameras``): ``matrix`` (3 x 3, pixels), ``distortions`` (k1 k2 p1
p2 k3, or four of ``cv2.fisheye`` where ``fisheye`` is true), ``rotation`` (rotation vector or 3 x 3) and
``translation``, world to camera in OpenCV's axes, ``size`` (width, height), ``name``. Other tables, such as anipose's
``metadata``, are not cameras. (mprib/caliscope; lambdaloop/aniposelib, cameras.py; perfanalytics/pose2sim,
calibration.py.)

caliscope names films ``cam_1.mp4`` or ``port_1.mp4``, Pose2Sim cameras ``int_cam01_img``: the number joins them, and
the film names the camera. Units of length are the file's own. Nothing is held out.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead
from ..camera import Camera, rotation_about
from ..capture import Capture
from ..lenses import FISHEYE
from .assembly import standing_cameras
from .checks import check_length, numbers, pinhole, rotation, size
from .footage import MAX_CAMERAS, Calibrated, find_below, natural, of_cameras
from .geometry import distortion, through_lens

_FOLDERS = (".", "calibration", "Calibration", "calibration/extrinsic")
_FOOTAGE = (".", "videos", "synchronized_videos", "recordings", "videos-raw", "images")
_MOST_FILES = 20
_LONGEST, _LONGEST_LINE = 2**20, 2**14  # bytes: what takes a parser long is no calibration
_NEEDED = ("matrix", "rotation", "translation")
_NAMES = ("camera_array.toml", "calibration.toml", "calib.toml")


def matches(path: Path) -> bool:
    """True if a TOML file in the folder, or in ``calibration`` below, has cameras."""
    return _calibration(path) is not None


def read(path: Path) -> Capture:
    """Open a folder of films with such a calibration.

    Raises:
        FrogError: if no camera has a film, or a value cannot be used.
    """
    file = _calibration(path)
    if file is None:
        raise found_instead(path, "no TOML calibration", "camera_array.toml, calibration.toml or Calib.toml")
    warnings: list[str] = []
    calibrated: dict[str, Calibrated] = {}
    for key, table in _tables(_parsed(file)).items():
        if table.get("ignore") is True:
            continue
        if any(not isinstance(table.get(needed), list) for needed in _NEEDED):
            warnings.append(f"{file}: the camera {key} has no pose and is left out.")
            continue
        camera, lens = _camera(key, table, file)
        if camera.name in calibrated:
            raise found_instead(file, f"several cameras named {camera.name}", "one of each name")
        calibrated[camera.name] = camera, lens
    if not calibrated:
        raise found_instead(file, "no camera with matrix, rotation and translation", "at least one")
    footage, about = of_cameras(file, list(calibrated), find_below(path, _FOOTAGE))
    pairs = sorted(
        ((found, calibrated[name]) for name, found in footage.items()), key=lambda pair: natural(pair[0].name)
    )
    cameras = [(replace(camera, name=found.name), lens) for found, (camera, lens) in pairs]
    return standing_cameras(path, "calibration_toml", cameras, [found for found, _ in pairs], [*warnings, *about])


def _calibration(path: Path) -> Path | None:
    """The first file that has cameras, or else that is named as one."""
    named = None
    for folder in _FOLDERS:
        files = sorted((path / folder).glob("*.toml"))[:_MOST_FILES] if (path / folder).is_dir() else []
        for file in files:
            try:
                if any(_is_camera(table) for table in _tables(_parsed(file)).values()):
                    return file
            except FrogError:
                named = named or (file if file.name.lower() in _NAMES else None)
    return named


def _parsed(file: Path) -> dict[str, object]:
    """The file's tables; FrogError where it is not TOML, or longer than a calibration."""
    check_length(file, "a TOML calibration")
    if file.stat().st_size > _LONGEST:
        raise found_instead(file, f"{file.stat().st_size:,} bytes", f"a TOML calibration of at most {_LONGEST:,}")
    try:
        text = file.read_text(encoding="utf-8-sig")
        if max(map(len, text.splitlines()), default=0) > _LONGEST_LINE:
            raise found_instead(file, f"a line of more than {_LONGEST_LINE:,} characters", "a TOML calibration")
        return tomllib.loads(text)
    except OSError as error:
        raise found_instead(file, f"a file that cannot be read ({error.strerror})", "a TOML calibration") from error
    except (ValueError, RecursionError, OverflowError) as error:
        raise found_instead(file, f"text that is not TOML ({error})", "a TOML calibration") from error


def _tables(data: Mapping[str, object]) -> dict[str, Mapping[str, object]]:
    """The tables that may be cameras, by key."""
    cameras = data.get("cameras")
    within = cameras if isinstance(cameras, dict) else data
    found = {key: table for key, table in within.items() if isinstance(table, dict) and "matrix" in table}
    return dict(list(found.items())[:MAX_CAMERAS])


def _is_camera(table: Mapping[str, object]) -> bool:
    return all(isinstance(table.get(needed), list) for needed in _NEEDED)


def _camera(key: str, table: Mapping[str, object], file: Path) -> Calibrated:
    given = table.get("name")
    name = given if isinstance(given, str) and given else key
    about = f"of camera {name}"
    width, height = (
        size(side, file, f"size {about}") for side in numbers(table.get("size"), (2,), file, f"size {about}")
    )
    pose = np.eye(4)
    pose[:3, :3] = _turn(table.get("rotation"), file, about)
    pose[:3, 3] = numbers(_flat(table.get("translation")), (3,), file, f"translation {about}")
    camera = Camera(name, width, height, pinhole(table.get("matrix"), file, f"matrix {about}"), pose)
    listed = _flat(table.get("distortions") or [])
    count = len(listed) if isinstance(listed, list) else 0
    coefficients = numbers(listed, (count,), file, f"distortions {about}")
    if table.get("fisheye") is True:
        if count < 4:
            raise found_instead(file, f"{count} distortions {about}", "4 of a fisheye")
        return through_lens(camera, FISHEYE, coefficients[:4], file)
    if count not in (0, 1, 4, 5, 8, 12, 14):  # what OpenCV takes, and k1 alone
        raise found_instead(file, f"{count} distortions {about}", "4, 5, 8, 12 or 14")
    if count == 1:
        coefficients = np.append(coefficients, np.zeros(4))
    return camera, distortion(coefficients)


def _turn(value: object, file: Path, about: str) -> Float64s:
    """(3, 3) world to camera of a rotation vector or a matrix."""
    if isinstance(value, list) and len(value) == 3 and isinstance(value[0], list) and len(value[0]) == 3:
        return rotation(numbers(value, (3, 3), file, f"rotation {about}"), file, f"the rotation {about}")
    return rotation_about(numbers(_flat(value), (3,), file, f"rotation {about}", most=100.0))


def _flat(value: object) -> object:
    """A list of numbers that stands as a row or a column of a matrix."""
    if isinstance(value, list) and value and all(isinstance(each, list) for each in value):
        return [number for each in value for number in each]
    return value
