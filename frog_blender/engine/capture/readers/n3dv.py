"""N3DV (Neural 3D Video): ``camNN.mp4``, or frames in ``camNN`` or ``camNN/images``, and ``poses_bounds.npy``.

Rows (see ``llff``) belong to the cameras sorted by name; the numbers in the names may have gaps. The first camera is
the test view.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...errors import FrogError, found_instead
from ..capture import Capture
from ..video import find_images
from .assembly import standing_cameras
from .footage import Footage, find_footage, on_common_frames
from .geometry import is_transposed
from .llff import read_rows, row_camera

_POSES = "poses_bounds.npy"


def matches(path: Path) -> bool:
    """True if the folder holds ``poses_bounds.npy``."""
    return (path / _POSES).is_file()


def read(path: Path) -> Capture:
    """Open an N3DV folder; folders of frames stand in for videos, and a folder ``images`` for videos of one frame.

    Raises:
        FrogError: if videos and rows do not fit, or a value cannot be used.
    """
    rows = read_rows(path / _POSES)
    footage = _footage(path)
    if not footage:
        raise found_instead(path, f"{len(rows)} poses and no video", f"{len(rows)} videos cam00.mp4, cam01.mp4, ...")
    if len(rows) != len(footage):
        raise FrogError(
            f"{path / _POSES}: found {len(rows)} rows for {len(footage)} videos ({footage[0].name} to "
            f"{footage[-1].name}), expected one row for each video."
        )
    filmed = on_common_frames(path, footage)
    warnings = []
    cameras = [
        row_camera(row, each.name, size, path / _POSES)
        for row, each, size in zip(rows, footage, filmed.sizes, strict=True)
    ]
    for camera, row in zip(cameras, rows, strict=True):
        stored_height, stored_width = row[4], row[9]
        if is_transposed((camera.width, camera.height), (stored_width, stored_height)):
            found = (
                f"{stored_width:g} x {stored_height:g} for images of {camera.width} x {camera.height} of {camera.name}"
            )
            raise found_instead(path / _POSES, found, "the same way up: they are turned by 90 degrees")
        if abs(camera.width / camera.height - stored_width / stored_height) > 0.01 * stored_width / stored_height:
            warnings.append(
                f"{path}: the images of {camera.name} are {camera.width} x {camera.height}, "
                f"{_POSES} says {stored_width:g} x {stored_height:g}: their proportions differ."
            )
    near_far = (float(rows[:, 15].min()), float(rows[:, 16].max()))
    capture = standing_cameras(path, "n3dv", [(camera, None) for camera in cameras], footage, warnings, filmed=filmed)
    return replace(
        capture,
        # With one camera nothing would be left to train on.
        test_cameras=frozenset({cameras[0].name}) if len(cameras) > 1 else frozenset(),
        near_far=near_far if 0 < near_far[0] < near_far[1] else None,
    )


def _footage(path: Path) -> list[Footage]:
    """What each row's camera filmed, in the plain order of names, as LLFF sorts them."""
    found = find_footage(path)
    of_cameras = [each for each in found if each.name.lower().startswith("cam")]
    if not of_cameras:
        of_cameras = [each for each in found if each.is_video]
    if not of_cameras and (path / "images").is_dir():
        of_cameras = [Footage(image.stem, (image,), (0,)) for image in find_images(path / "images")]
    return sorted(of_cameras, key=lambda footage: footage.name)
