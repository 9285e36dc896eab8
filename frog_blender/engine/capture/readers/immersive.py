"""Google Immersive Light Field Video: ``models.json`` and ``camera_0001.mp4``, or folders of frames.

A list of cameras: ``name``, ``width``, ``height``, ``focal_length``, ``principal_point``, ``pixel_aspect_ratio`` (1
where it is missing), ``orientation`` (rotation vector, world to camera), ``position`` (the centre),
``radial_distortion``. All are fisheyes: the angle theta to the axis is seen at focal length times theta (1 + k1
theta^2 + k2 theta^4), which is ``cv2.fisheye``. (Broxton et al. 2020; oppo-us-research/SpacetimeGaussians,
script/pre_immersive_distorted.py.)

Axes are OpenCV's. The first camera, in the rig's middle, is held out, as SpacetimeGaussians does.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import found_instead
from ..camera import Camera
from ..capture import Capture
from ..lenses import FISHEYE
from .assembly import matched, standing_cameras
from .checks import numbers, parsed_json, records, size
from .geometry import Calibrated, nerfies_view, through_lens
from .projects import recorded

_MODELS = "models.json"


def matches(path: Path) -> bool:
    """True if the folder holds ``models.json``."""
    return (path / _MODELS).is_file()


def read(path: Path) -> Capture:
    """Open a scene's folder.

    Raises:
        FrogError: if no camera has a film, or a value cannot be used.
    """
    file = path / _MODELS
    entries = records(parsed_json(file), file, "cameras", '[{"name": "camera_0001", ...}, ...]')
    cameras = [_camera(entry, file) for entry in entries]
    footage = recorded(path, [camera.name for camera, _ in cameras])
    capture = standing_cameras(path, "immersive", *matched(file, cameras, footage))
    first, *others = (camera.name for camera in capture.cameras)
    return replace(capture, test_cameras=frozenset({first} if others else ()))


def _camera(entry: dict[str, object], file: Path) -> Calibrated:
    name = entry.get("name")
    if not isinstance(name, str) or not name:
        raise found_instead(file, "a camera without a name", "the name of its film")
    width, height = (size(entry.get(side), file, f"{side} of {name}") for side in ("width", "height"))
    listed = entry.get("radial_distortion", [0.0, 0.0])
    count = len(listed) if isinstance(listed, list) else 0
    if not 1 <= count <= 4:
        raise found_instead(file, f"radial_distortion of {name} that is no list of 1 to 4 numbers", "[k1, k2]")
    radial = np.zeros(4)
    radial[:count] = numbers(listed, (count,), file, f"radial_distortion of {name}")
    camera = Camera(name, width, height, *nerfies_view(entry, file, f" of {name}"))
    if (projection := entry.get("projection_type", FISHEYE)) != FISHEYE:
        raise found_instead(file, f"the projection_type {projection} of {name}", "fisheye")
    return through_lens(camera, FISHEYE, radial, file)
