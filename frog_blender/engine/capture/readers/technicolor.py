"""The Technicolor light field: ``SCENE_undist_FRAME_CAMERA.png`` and ``cameras_parameters.txt``.

Sixteen synchronized cameras in a 4 x 4 grid, 2048 x 1088 pixels, lens distortion already removed. A header line, then
a row for each camera: focal length, principal point (far from the centre), aspect, skew, the quaternion w x y z and the
translation from world to camera (OpenCV's axes). f_y is f_x times the aspect, as in HyperReel; ST-GS and E-D3DGS leave
the aspect out. (facebookresearch/hyperreel, datasets/technicolor.py; SpacetimeGaussians, script/pre_technicolor.py.)

The test view is row 2, column 2 of the grid, counted from 0: camera 10.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead
from ...io.regular_file import read_text, regular_file
from ..camera import Camera
from ..capture import Capture
from .assembly import standing_cameras
from .checks import frame_span, numbers
from .footage import Footage
from .geometry import Calibrated, distortion, from_quaternion, intrinsics, pose

_PARAMETERS = "cameras_parameters.txt"
_IMAGE = re.compile(r"(?P<scene>[^.].*)_undist_(?P<frame>\d{1,9})_(?P<camera>\d{1,4})\.png", re.IGNORECASE)
_CALIBRATED = (2048, 1088)  # pixels that the parameters belong to
_COLUMNS = 12
_TEST_CAMERA = "cam10"
_PNG_END = b"IEND\xaeB\x60\x82"


def matches(path: Path) -> bool:
    """True if the folder holds ``cameras_parameters.txt``."""
    return (path / _PARAMETERS).is_file()


def read(path: Path) -> Capture:
    """Open a scene's folder, whose images lie in it or in ``images`` beneath.

    An image that is cut off (Birthday's frame 173 of camera 9 is published so) is replaced by that of the same
    camera's frame before; of the test camera it is left out, because a repeated frame would falsify the evaluation.

    Raises:
        FrogError: if there is no whole image, or a value cannot be used.
    """
    rows = _read_rows(path / _PARAMETERS)
    files = _find_images(path, len(rows))
    numbered = {frame for _, frame in files}
    frame_span(min(numbered), max(numbered), path, "images of frames")
    warnings: list[str] = []
    images: dict[int, dict[int, Path]] = {}
    for (camera, frame), file in _whole_images(files, warnings).items():
        images.setdefault(camera, {})[frame] = file
    footage = {camera: Footage(f"cam{camera:02d}", tuple(own.values()), tuple(own)) for camera, own in images.items()}
    if not footage:
        raise found_instead(path, "images that are all cut off", "whole ones")
    if len(footage) < len(rows):
        warnings.append(f"{path}: {_PARAMETERS} has {len(rows)} cameras, and {len(footage)} of them have images.")
    names = [filmed.name for filmed in footage.values()]
    if _TEST_CAMERA not in names:
        warnings.append(f"{path}: the test view {_TEST_CAMERA} has no images, so no camera is held out.")
    cameras = [_camera(filmed.name, rows[camera], path / _PARAMETERS) for camera, filmed in footage.items()]
    capture = standing_cameras(path, "technicolor", cameras, list(footage.values()), warnings)
    return replace(capture, test_cameras=frozenset({_TEST_CAMERA} & {*names} if len(names) > 1 else ()))


def _read_rows(path: Path) -> Float64s:
    """(cameras, 12) float64 rows, checked."""
    rows = []
    for position, line in enumerate(read_text(path, "a row for each camera", foreign=True).splitlines(), start=1):
        try:
            if fields := line.split():  # rows end in blanks
                rows.append(numbers(np.array(fields), (_COLUMNS,), path, f"line {position}"))
        except FrogError:
            if position > 1:  # else the header
                raise
    if not rows:
        raise found_instead(path, "no row after the header", f"{_COLUMNS} numbers for each camera")
    return np.array(rows)


def _find_images(path: Path, cameras: int) -> dict[tuple[int, int], Path]:
    """The images by (camera, frame number)."""
    for folder in filter(Path.is_dir, (path, path / "images")):
        named = [(file, match) for file in sorted(folder.iterdir()) if (match := _IMAGE.fullmatch(file.name))]
        if len(scenes := {match["scene"] for _, match in named}) > 1:
            raise found_instead(folder, f"images of {' and '.join(sorted(scenes))}", "those of one scene")
        files = {(int(match["camera"]), int(match["frame"])): file for file, match in named}
        if files and (last := max(files))[0] >= cameras:
            found = f"{cameras} rows and images of camera {last[0]} ({files[last].name})"
            raise found_instead(path / _PARAMETERS, found, "a row for each camera from 0")
        if files:
            return files
    raise found_instead(path, f"{_PARAMETERS} and no image", "images named SCENE_undist_00151_00.png and so on")


def _camera(name: str, row: Float64s, path: Path) -> Calibrated:
    """The camera of one row at the size it was calibrated at; skew is what remains to be removed."""
    focal, center_x, center_y, aspect, skew = row[:5]
    if min(focal, aspect) <= 0:
        raise found_instead(path, f"a focal length or aspect of zero or less for {name}", "positive numbers")
    turn = from_quaternion(row[5:9], path, f"the row of {name}")
    lens = intrinsics(focal, focal * aspect, center_x, center_y)
    camera = Camera(name, *_CALIBRATED, lens, pose(turn, -turn.T @ row[9:12]))
    return camera, distortion(np.zeros(5), skew / focal if skew else 0.0)


def _whole_images(files: dict[tuple[int, int], Path], warnings: list[str]) -> dict[tuple[int, int], Path]:
    """The images, damaged ones replaced by the frame before of the same camera, or left out where none is whole."""
    whole: dict[tuple[int, int], Path] = {}
    for (camera, frame), file in sorted(files.items()):
        before = whole.get((camera, frame - 1))
        if _is_whole(file):
            whole[camera, frame] = file
        elif before is None or f"cam{camera:02d}" == _TEST_CAMERA:
            warnings.append(f"{file}: the image is cut off and left out.")
        else:
            whole[camera, frame] = before
            warnings.append(f"{file}: the image is cut off; {before.name} takes its place.")
    return whole


def _is_whole(image: Path) -> bool:
    """True if a PNG has its end; decoders fill what is missing with black and say nothing."""
    with regular_file(image, "an image").open("rb") as file:
        file.seek(max(0, image.stat().st_size - 1024))
        return _PNG_END in file.read()
