"""Films and a TOML calibration as caliscope, anipose, freemocap and Pose2Sim write it.

A table for each camera (in caliscope's file below ``cameras``): ``matrix`` (3 x 3, pixels), ``distortions`` (k1 k2 p1
p2 k3, or four of ``cv2.fisheye`` where ``fisheye`` is true), ``rotation`` (rotation vector or 3 x 3) and
``translation``, world to camera in OpenCV's axes, ``size`` (width, height), ``name``. Other tables, such as anipose's
``metadata``, are not cameras. (mprib/caliscope; lambdaloop/aniposelib, cameras.py; perfanalytics/pose2sim,
calibration.py.)

caliscope names films ``cam_1.mp4`` or ``port_1.mp4``, anipose ``vid01-camA.mp4``, Pose2Sim cameras ``int_cam01_img``:
a part of the name or the number joins them, and the film names the camera. Units of length are the file's own. Nothing
is held out.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path

from ...errors import found_instead
from ...io.regular_file import read_text
from ..capture import Capture
from .assembly import matched, standing_cameras
from .checks import flag, numbers, size
from .footage import MAX_CAMERAS
from .geometry import Calibrated, flat, opencv_camera
from .projects import calibrations, recorded, the_calibration

_LONGEST, _LONGEST_LINE = 2**20, 2**14  # bytes: what takes a parser long is no calibration
_NEEDED = ("matrix", "rotation", "translation")


def matches(path: Path) -> bool:
    """True if a TOML file of the project, or of that which a recording belongs to, has cameras."""
    return any(calibrations(path, "*.toml", _names))


def read(path: Path) -> Capture:
    """Open a folder of films with such a calibration.

    Raises:
        FrogError: if no camera has a film, or a value cannot be used.
    """
    file = the_calibration(path, "*.toml", _names)
    tables = {key: table for key, table in _tables(file).items() if not flag(table.get("ignore"), file, "ignore")}
    posed = {key: table for key, table in tables.items() if _is_camera(table)}
    warnings = [f"{file}: the camera {key} has no pose and is left out." for key in tables if key not in posed]
    cameras = [_camera(key, table, file) for key, table in posed.items()]
    if not cameras:
        raise found_instead(file, "no camera with matrix, rotation and translation", "at least one")
    footage = recorded(path, [camera.name for camera, _ in cameras])
    cameras, footage, about = matched(file, cameras, footage, named_by_film=True)
    return standing_cameras(path, "calibration_toml", cameras, footage, [*warnings, *about])


def _names(file: Path) -> list[str]:
    """Those of the cameras with poses."""
    return [_name(key, table) for key, table in _tables(file).items() if _is_camera(table)]


def _name(key: str, table: Mapping[str, object]) -> str:
    given = table.get("name")
    return given if isinstance(given, str) and given else key


def _tables(file: Path) -> dict[str, Mapping[str, object]]:
    """The tables that may be cameras, by key; FrogError for a file that is not TOML, or longer than a calibration."""
    text = read_text(file, "a TOML calibration", _LONGEST, foreign=True)
    if max(map(len, text.splitlines()), default=0) > _LONGEST_LINE:
        raise found_instead(file, f"a line of more than {_LONGEST_LINE:,} characters", "a TOML calibration")
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError, OverflowError) as error:
        raise found_instead(file, f"text that is not TOML ({error})", "a TOML calibration") from error
    within = cameras if isinstance(cameras := data.get("cameras"), dict) else data
    tables = {key: table for key, table in within.items() if isinstance(table, dict) and "matrix" in table}
    return dict(list(tables.items())[:MAX_CAMERAS])


def _is_camera(table: Mapping[str, object]) -> bool:
    return all(isinstance(value := table.get(needed), list) and value for needed in _NEEDED)


def _camera(key: str, table: Mapping[str, object], file: Path) -> Calibrated:
    name = _name(key, table)
    what = f"size of camera {name}"
    width, height = (size(side, file, what) for side in numbers(table.get("size"), (2,), file, what))
    lens = flat(table.get("distortions") or [])
    if isinstance(lens, list) and len(lens) == 1:  # k1 alone
        lens = [*lens, 0.0, 0.0, 0.0]
    values = {needed: table[needed] for needed in _NEEDED} | {"distortions": lens}
    return opencv_camera(
        name, (width, height), values, file, is_fisheye=flag(table.get("fisheye"), file, f"fisheye of camera {name}")
    )
