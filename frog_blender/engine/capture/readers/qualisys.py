"""Qualisys Track Manager's calibration, ``*.qca.txt``: XML with lengths in mm and pixels times 64.

Only the reading of it; ``calibrated_videos`` joins it with the videos.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...errors import found_instead
from ..camera import Camera
from ..capture import Distortion
from .checks import check_length, number, rotation, size
from .geometry import OPENGL_AXES, distortion, pose

_SUBPIXELS = 64.0  # the file counts pixels in sixty-fourths


def read_cameras(path: Path) -> list[tuple[Camera, Distortion | None]]:
    """The calibrated cameras, in metres and OpenCV's axes, named by their serial.

    Raises:
        FrogError: if the file is not such a calibration, or a value is missing.
    """
    check_length(path, "a Qualisys calibration")
    text = path.read_bytes()
    # Entities can blow a small file up or read other files; a calibration needs none (UTF-16 would hide them).
    if b"<!doctype" in text.lower() or b"<!entity" in text.lower() or b"\0" in text:
        raise found_instead(path, "XML with a document type or entities", "a plain Qualisys calibration")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise found_instead(path, f"text that is not XML ({error})", "a Qualisys calibration") from error
    cameras = [_read_camera(element, path) for element in root.iter("camera")]
    if not cameras:
        raise found_instead(path, "no camera", "a Qualisys calibration with cameras")
    return cameras


def _read_camera(element: ElementTree.Element, path: Path) -> tuple[Camera, Distortion | None]:
    name = element.get("serial") or ""
    if not name:
        raise found_instead(path, "a camera without a serial", "a serial that names the camera's video")

    def value(child: str, attribute: str, default: float | None = None) -> float:
        found = element.find(child)
        text = None if found is None else found.get(attribute)
        if text is None and default is not None:
            return default
        return number(text, path, f"{child} {attribute} of camera {name}")

    left, top = value("fov_video", "left", 0.0), value("fov_video", "top", 0.0)
    width = size(value("fov_video", "right") - left + 1, path, f"the width of camera {name}")
    height = size(value("fov_video", "bottom") - top + 1, path, f"the height of camera {name}")
    intrinsics = np.eye(3)
    for row, axis, start in ((0, "U", left), (1, "V", top)):
        intrinsics[row, row] = value("intrinsic", f"focalLength{axis}") / _SUBPIXELS
        intrinsics[row, 2] = value("intrinsic", f"centerPoint{axis}") / _SUBPIXELS - start
    if min(intrinsics[0, 0], intrinsics[1, 1]) <= 0:
        raise found_instead(path, f"a focal length of zero or less for camera {name}", "a positive one")
    # The rows are the camera's axes in the world; Qualisys' camera looks along -z with y up.
    rows = np.array([[value("transform", f"r{i}{j}") for j in (1, 2, 3)] for i in (1, 2, 3)])
    world_to_camera = rotation(OPENGL_AXES @ rows, path, f"the rotation of camera {name}")
    center = np.array([value("transform", axis) for axis in "xyz"]) / 1000.0
    names = (
        "radialDistortion1",
        "radialDistortion2",
        "tangentalDistortion1",
        "tangentalDistortion2",
        "radialDistortion3",
    )
    coefficients = np.array([value("intrinsic", key, 0.0) for key in names]) / _SUBPIXELS
    camera = Camera(name, width, height, intrinsics, pose(world_to_camera, center))
    return camera, distortion(coefficients)
