"""Videos or folders of frames with LLFF's rows of poses: N3DV (Neural 3D Video), and 4DGaussians' multipleview.

A row is a 3 x 5 matrix [R | t | (H, W, f)], camera-to-world, followed by near and far. The columns of R are LLFF's axes
(down, right, backwards). The principal point is the image's centre. (Fyusion/LLFF, README.)

**N3DV**: ``camNN.mp4``, or frames in ``camNN`` or ``camNN/images``, and ``poses_bounds.npy``. Rows belong to the
cameras sorted by name; the numbers in the names may have gaps. The first camera is the test view.

**multipleview**: ``cam01/frame_00001.jpg``, with COLMAP's model of the first frames in ``sparse_``. An image of the
model belongs to the camera folder with its number (``image1.jpg`` to ``cam01``). Without ``sparse_`` the rows of
``poses_bounds_multipleview.npy`` belong to the folders in their natural order. Times are the numbers of the frames.
Nothing is held out: 4DGaussians tests on images it has trained on. (hustvl/4DGaussians,
scene/multipleview_dataset.py and multipleviewprogress.sh.)
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ..camera import Camera
from ..capture import Capture
from ..natural_order import natural
from .assembly import matched, standing_cameras, with_points
from .checks import numbers, read_table, rotation
from .colmap_model import has_model, read_model
from .footage import MAX_CAMERAS, Footage, find_footage, images_in, regrouped
from .geometry import intrinsics, is_transposed, pose
from .readings import chosen, is_moment

_POSES, _MULTIPLEVIEW_POSES = "poses_bounds.npy", "poses_bounds_multipleview.npy"
_MODELS = ("sparse_", "sparse_/0")


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
    capture, near_far = _read_rows(path, "n3dv", path / _POSES, footage, order=lambda name: name)
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


def _read_rows(
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


def _is_multipleview(path: Path) -> bool:
    """True if the folder holds ``sparse_`` with a model, or ``poses_bounds_multipleview.npy``."""
    return (path / _MULTIPLEVIEW_POSES).is_file() or any(has_model(path / name) for name in _MODELS)


def _read_multipleview(path: Path) -> Capture:
    """Open a multipleview folder.

    Raises:
        FrogError: if no camera has a folder of frames, or a value cannot be used.
    """
    footage = find_footage(path)
    footage = [filmed for filmed in footage if filmed.name.lower().startswith("cam")] or footage
    if not footage:
        raise found_instead(path, "no folder of frames", "cam01, cam02, ... with frame_00001.jpg, ...")
    folder = next((path / name for name in _MODELS if has_model(path / name)), None)
    if folder is None:
        return _read_rows(path, "multipleview", path / _MULTIPLEVIEW_POSES, footage)[0]
    model = read_model(folder)
    cameras = [model.camera(image, PurePosixPath(image.name).stem) for image in model.images]
    of_films = matched(folder, cameras, footage, named_by_film=True)
    return with_points(standing_cameras(path, "multipleview", *of_films), model.points)


MULTIPLEVIEW = SimpleNamespace(matches=_is_multipleview, read=_read_multipleview)
