"""N3DV (Neural 3D Video): ``camNN.mp4``, or frames in ``camNN`` or ``camNN/images``, and ``poses_bounds.npy``.

Rows belong to the cameras sorted by name; the numbers in the names may have gaps. The first camera is the test view.

A row is LLFF's, a 3 x 5 matrix [R | t | (H, W, f)], camera-to-world, followed by near and far. The columns of R are
LLFF's axes (down, right, backwards). The principal point is the image's centre. (Fyusion/LLFF, README.) 4DGaussians'
multipleview captures have such rows, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ..camera import Camera
from ..capture import Capture
from ..natural_order import natural
from .assembly import standing_cameras
from .checks import numbers, read_table, rotation
from .footage import MAX_CAMERAS, Footage, find_footage, images_in, regrouped
from .geometry import intrinsics, is_transposed, pose
from .readings import chosen, is_moment

_POSES = "poses_bounds.npy"


def matches(path: Path) -> bool:
    """True if the folder holds ``poses_bounds.npy``."""
    return (path / _POSES).is_file()


def read(path: Path) -> Capture:
    """Open an N3DV folder. Folders of frames, or of moments, stand in for videos, and ``images`` for one moment.

    Raises:
        FrogError: if videos and rows do not fit, or a value cannot be used.
    """
    footage = _footage(path)
    if not footage:
        raise found_instead(path, f"{_POSES} and no video", "a video for each pose: cam00.mp4, cam01.mp4, ...")
    capture, near_far = read_rows(path, "n3dv", path / _POSES, footage, order=lambda name: name)
    first, *others = (camera.name for camera in capture.cameras)
    held_out = frozenset({first} if others else ())  # of one camera nothing would be left to train on
    return replace(capture, test_cameras=held_out, near_far=near_far)


def _footage(path: Path) -> list[Footage]:
    """What the cameras filmed."""
    footage = find_footage(path)
    of_cameras = [filmed for filmed in footage if filmed.name.lower().startswith("cam")]
    if not of_cameras:
        of_cameras = [filmed for filmed in footage if filmed.is_video or is_moment(filmed.name)]
    if not of_cameras and (path / "images").is_dir():
        of_cameras = [filmed for filmed in [images_in(path / "images")] if filmed]
    return of_cameras


def read_rows(
    path: Path, layout: str, file: Path, footage: Sequence[Footage], *, order: Callable[[str], Any] = natural
) -> tuple[Capture, tuple[float, float]]:
    """The capture of a file of rows, a row for each camera, and the depths between which the scene lies.

    Args:
        order: of the cameras' names, the key of the rows' order; LLFF sorts them plainly.

    Raises:
        FrogError: for a file of another shape, or a value that cannot be used.
    """
    stored = read_table(file, 17, MAX_CAMERAS, "cameras")
    rows = np.array([numbers(row, (17,), file, f"row {index}") for index, row in enumerate(stored)]).reshape(-1, 17)
    bad = np.flatnonzero((rows[:, [4, 9, 14]] <= 0).any(axis=1))
    if bad.size:
        found = f"a height, width or focal length of zero or less in row {bad[0]}"
        raise found_instead(file, found, "positive numbers")
    ways = {reading: films for reading, films in regrouped(footage) if len(films) == len(rows)}
    if not ways:
        names = f"{footage[0].name} to {footage[-1].name}"
        found = f"{len(rows)} rows for {len(footage)} videos or folders of frames ({names})"
        raise found_instead(file, found, "one row for each")
    footage = sorted(ways[chosen(path, list(ways))], key=lambda filmed: order(filmed.name))
    warnings: list[str] = []
    cameras = [(_camera(row, filmed, file, warnings), None) for row, filmed in zip(rows, footage, strict=True)]
    capture = standing_cameras(path, layout, cameras, footage, warnings)
    return capture, (float(rows[:, 15].min()), float(rows[:, 16].max()))


def _camera(row: Float64s, filmed: Footage, file: Path, warnings: list[str]) -> Camera:
    """The OpenCV camera of one row, at the size of its decoded frames."""
    name, width, height = filmed.name, filmed.facts.width, filmed.facts.height
    matrix = row[:15].reshape(3, 5)
    down, right, backwards = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    camera_to_world = rotation(np.stack([right, down, -backwards], axis=1), file, f"the pose of {name}")
    stored_height, stored_width, focal = matrix[:, 4]
    said = f"{stored_width:g} x {stored_height:g}"
    if is_transposed((width, height), (stored_width, stored_height)):
        found = f"{said} for images of {width} x {height} of {name}"
        raise found_instead(file, found, "the same way up: they are turned by 90 degrees")
    if abs(width / height - stored_width / stored_height) > 0.01 * stored_width / stored_height:
        warnings.append(
            f"{file.parent}: the images of {name} are {width} x {height}, {file.name} says {said}: their proportions "
            "differ."
        )
    lens = intrinsics(focal * width / stored_width, focal * height / stored_height, width / 2, height / 2)
    return Camera(name, width, height, lens, pose(camera_to_world.T, matrix[:, 3]))
