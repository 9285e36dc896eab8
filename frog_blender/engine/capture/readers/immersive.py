"""Google Immersive Light Field Video: ``models.json`` and ``camera_0001.mp4``, or folders of frames.

A list of cameras: ``name``, ``width``, ``height``, ``focal_length``, ``principal_point``, ``pixel_aspect_ratio`` (1
where it is missing), ``orientation`` (rotation vector, world to camera), ``position`` (the centre),
``radial_distortion``. All are fisheyes: the angle theta to the axis is seen at focal length times theta (1 + k1
theta^2 + k2 theta^4), which is ``cv2.fisheye``. (Broxton et al. 2020; oppo-us-research/SpacetimeGaussians,
script/pre_immersive_distorted.py.)

Axes are OpenCV's. The first camera, in the rig's middle, is held out, as SpacetimeGaussians does.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import found_instead
from ..camera import Camera, rotation_about
from ..capture import Capture
from ..lenses import FISHEYE
from .assembly import standing_cameras
from .checks import check_length, number, numbers, size
from .footage import MAX_CAMERAS, Calibrated, find_below, natural, of_cameras
from .geometry import distortion, intrinsics, pose, through_lens

_MODELS = "models.json"
_FOOTAGE = (".", "videos", "images")


def matches(path: Path) -> bool:
    """True if the folder holds ``models.json``."""
    return (path / _MODELS).is_file()


def read(path: Path) -> Capture:
    """Open a scene's folder.

    Raises:
        FrogError: if no camera has a film, or a value cannot be used.
    """
    file = path / _MODELS
    calibrated: dict[str, Calibrated] = {}
    for entry in _entries(file):
        camera, lens = _camera(entry, file)
        if camera.name in calibrated:
            raise found_instead(file, f"several cameras named {camera.name}", "one of each name")
        calibrated[camera.name] = camera, lens
    footage, warnings = of_cameras(file, list(calibrated), find_below(path, _FOOTAGE))
    names = sorted(footage, key=natural)
    cameras = [calibrated[name] for name in names]
    capture = standing_cameras(path, "immersive", cameras, [footage[name] for name in names], warnings)
    return replace(capture, test_cameras=frozenset(names[:1] if len(names) > 1 else []))


def _entries(file: Path) -> list[dict[str, object]]:
    try:
        check_length(file, "a JSON file")
        data = json.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise found_instead(file, f"a file that cannot be read ({error.strerror})", "a JSON file") from error
    except (ValueError, RecursionError) as error:
        raise found_instead(file, f"text that is not JSON ({type(error).__name__})", "a complete JSON file") from error
    if not isinstance(data, list) or not data or not all(isinstance(entry, dict) for entry in data):
        raise found_instead(file, "no list of cameras", '[{"name": "camera_0001", ...}, ...]')
    if len(data) > MAX_CAMERAS:
        raise found_instead(file, f"{len(data):,} cameras", f"at most {MAX_CAMERAS:,}")
    return data


def _camera(entry: dict[str, object], file: Path) -> Calibrated:
    name = entry.get("name")
    if not isinstance(name, str) or not name:
        raise found_instead(file, "a camera without a name", "the name of its film")
    width, height = (size(entry.get(side), file, f"{side} of {name}") for side in ("width", "height"))
    focal = number(entry.get("focal_length"), file, f"focal_length of {name}", positive=True)
    aspect = number(entry.get("pixel_aspect_ratio", 1.0), file, f"pixel_aspect_ratio of {name}", positive=True)
    center = numbers(entry.get("principal_point"), (2,), file, f"principal_point of {name}")
    turn = rotation_about(numbers(entry.get("orientation"), (3,), file, f"orientation of {name}", most=100.0))
    position = numbers(entry.get("position"), (3,), file, f"position of {name}")
    listed = entry.get("radial_distortion", [0.0, 0.0])
    count = len(listed) if isinstance(listed, list) else 0
    if not 1 <= count <= 4:
        raise found_instead(file, f"radial_distortion of {name} that is no list of 1 to 4 numbers", "[k1, k2]")
    radial = np.zeros(4)
    radial[:count] = numbers(listed, (count,), file, f"radial_distortion of {name}")
    camera = Camera(name, width, height, intrinsics(focal, focal * aspect, *center), pose(turn, position))
    projection = entry.get("projection_type", FISHEYE)
    if projection == FISHEYE:
        return through_lens(camera, FISHEYE, radial, file)
    if projection != "perspective":
        raise found_instead(file, f"the projection_type {projection} of {name}", "fisheye or perspective")
    return camera, distortion(np.array([radial[0], radial[1], 0.0, 0.0, radial[2]]))
