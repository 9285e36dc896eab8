"""The Technicolor light field: ``SCENE_undist_FRAME_CAMERA.png`` and ``cameras_parameters.txt``.

Sixteen synchronised cameras in a 4 x 4 grid, 2048 x 1088 pixels, lens distortion already removed. A header line, then
a row for each camera: focal length, principal point (far from the centre), aspect, skew, the quaternion w x y z and the
translation from world to camera (OpenCV's axes). f_y is f_x times the aspect, as in HyperReel; ST-GS and E-D3DGS leave
the aspect out. (facebookresearch/hyperreel, datasets/technicolor.py; SpacetimeGaussians, script/pre_technicolor.py.)

The test view is row 2, column 2 of the grid, counted from 0: camera 10.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead
from ...io.regular_file import regular_file
from ..camera import Camera
from ..capture import Capture, Distortion, Shot
from ..video import image_size
from .checks import check_length, frame_span, numbers
from .geometry import distortion, intrinsics, pose, same_proportions

_PARAMETERS = "cameras_parameters.txt"
_IMAGE = re.compile(r"(?P<scene>[^.].*)_undist_(?P<frame>\d{1,9})_(?P<camera>\d{1,4})\.png", re.IGNORECASE)
_CALIBRATED = (2048, 1088)  # pixels that the parameters belong to
_COLUMNS = 12
_TEST_CAMERA = "cam10"
_PNG_END = b"IEND\xaeB\x60\x82"


def matches(path: Path) -> bool:
    """True if the folder holds ``cameras_parameters.txt``."""
    return (path / _PARAMETERS).is_file()


def read(path: Path, frames: range | None = None) -> Capture:
    """Open a scene's folder, whose images lie in it or in ``images`` beneath.

    An image that is cut off (Birthday's frame 173 of camera 9 is published so) is replaced by that of the same
    camera's frame before; of the test camera it is left out, because a repeated frame would falsify the evaluation.

    Args:
        frames: numbers of the frames to take, as in the files' names; by default all from the lowest to the highest.

    Raises:
        FrogError: if one of ``frames`` has no image at all, or a value cannot be used.
    """
    rows = _read_rows(path / _PARAMETERS)
    files = _find_images(path, len(rows))
    found = {frame for _, frame in files}
    if frames is None:
        frames = range(min(found), min(found) + frame_span(min(found), max(found), path, "images of frames"))
    elif not found.issuperset(frames):
        expected = f"every frame from {frames[0]} to {frames[-1]}"
        raise found_instead(path, f"frames between {min(found)} and {max(found)}", expected)
    files = {key: file for key, file in files.items() if key[1] in frames}
    used = sorted({camera for camera, _ in files})
    place = {camera: index for index, camera in enumerate(used)}
    cameras: list[Camera] = []
    distortions: list[Distortion | None] = []
    for index in used:
        own = [file for (camera, _), file in sorted(files.items()) if camera == index]
        example = next((file for file in own if _is_whole(file)), own[0])  # others are replaced or left out below
        camera, lens_distortion = _camera(f"cam{index:02d}", rows[index], path / _PARAMETERS)
        cameras.append(camera.resized(*_image_size(example)))
        distortions.append(lens_distortion)
    warnings = []
    if len(used) < len(rows):
        warnings.append(f"{path}: {_PARAMETERS} has {len(rows)} cameras, and {len(used)} of them have images.")
    if missing := len(used) * len(frames) - len(files):
        warnings.append(f"{path}: {missing} of {len(used) * len(frames)} images are missing and left out.")
    whole = _replace_damaged(files, warnings)
    names = {camera.name for camera in cameras}
    if _TEST_CAMERA not in names:
        warnings.append(f"{path}: the test view {_TEST_CAMERA} has no images, so no camera is held out.")
    return Capture(
        path=path,
        format="technicolor",
        cameras=tuple(cameras),
        distortions=tuple(distortions),
        shots=tuple(Shot(place[camera], frame - frames[0], file, 0) for (camera, frame), file in whole.items()),
        frame_count=len(frames),
        test_cameras=frozenset({_TEST_CAMERA} & names) if len(names) > 1 else frozenset(),
        warnings=tuple(warnings),
    )


def _read_rows(path: Path) -> Float64s:
    """(cameras, 12) float64 rows, checked."""
    try:
        check_length(path, "a row for each camera")
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "a row for each camera") from error
    rows = []
    for position, line in enumerate(lines, start=1):
        fields = line.split()  # rows end in blanks
        try:
            values = [float(field) for field in fields]
        except ValueError as error:
            if position == 1:  # the header
                continue
            raise found_instead(path, f"line {position} with words", f"{_COLUMNS} numbers") from error
        if not fields or (position == 1 and len(fields) != _COLUMNS):
            continue
        rows.append(numbers(values, (_COLUMNS,), path, f"line {position}"))
    if not rows:
        raise found_instead(path, "no row after the header", f"{_COLUMNS} numbers for each camera")
    return np.array(rows)


def _find_images(path: Path, cameras: int) -> dict[tuple[int, int], Path]:
    """The images by (camera, frame number)."""
    for folder in (path, path / "images"):
        if not folder.is_dir():
            continue
        named = [(file, match) for file in sorted(folder.iterdir()) if (match := _IMAGE.fullmatch(file.name))]
        if not named:
            continue
        scenes = Counter(match["scene"] for _, match in named)
        if len(scenes) > 1:
            raise found_instead(folder, f"images of {' and '.join(sorted(scenes))}", "those of one scene")
        files = {(int(match["camera"]), int(match["frame"])): file for file, match in named}
        highest = max(camera for camera, _ in files)
        if highest >= cameras:
            raise FrogError(
                f"{path / _PARAMETERS}: found {cameras} rows and images of camera {highest} "
                f"({files[max(files)].name}), expected a row for each camera from 0."
            )
        return files
    raise found_instead(path, f"{_PARAMETERS} and no image", "images named SCENE_undist_00151_00.png and so on")


def _camera(name: str, row: Float64s, path: Path) -> tuple[Camera, Distortion | None]:
    """The camera of one row at the size it was calibrated at; skew is what remains to be removed."""
    focal, center_x, center_y, aspect, skew = row[:5]
    if min(focal, aspect) <= 0:
        raise found_instead(path, f"a focal length or aspect of zero or less for {name}", "positive numbers")
    w, x, y, z = row[5:9]
    length = float(np.linalg.norm(row[5:9]))
    if abs(length - 1) > 0.02:
        raise found_instead(path, f"a quaternion of length {length:g} for {name}", "one of length 1")
    w, x, y, z = row[5:9] / length
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    lens = intrinsics(focal, focal * aspect, center_x, center_y)
    camera = Camera(name, *_CALIBRATED, lens, pose(matrix, -matrix.T @ row[9:12]))
    return camera, distortion(np.zeros(5), skew / focal if skew else 0.0)


def _image_size(image: Path) -> tuple[int, int]:
    """(width, height) of an image, checked against the proportions of the calibration."""
    width, height = size = image_size(image)
    if not same_proportions(size, _CALIBRATED):
        expected = f"the proportions of {_CALIBRATED[0]} x {_CALIBRATED[1]}"
        raise found_instead(image, f"an image of {width} x {height} pixels", expected)
    return width, height


def _replace_damaged(files: dict[tuple[int, int], Path], warnings: list[str]) -> dict[tuple[int, int], Path]:
    """The images, damaged ones replaced by the frame before of the same camera, or left out where none is whole."""
    whole = {key: file for key, file in files.items() if _is_whole(file)}
    for (camera, frame), file in sorted(files.items()):
        if (camera, frame) in whole:
            continue
        before = whole.get((camera, frame - 1))
        if before is None or f"cam{camera:02d}" == _TEST_CAMERA:
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
