"""Checks of values from files, which all readers share, and their errors."""

import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np

from ...arrays import Array, Float64s
from ...errors import FrogError, brief, found_instead
from ...io.numpy_files import read_npy
from ...io.regular_file import read_text
from ..camera import MAX_SIDE, exact_pinhole
from ..capture import MAX_FRAMES, MAX_IMAGES, Capture
from ..video import with_ending

MAX_COORDINATE = 1e12
"""World units or pixels: larger values were not measured, and their products are not finite."""
_MIN_FOCAL = 1e-6  # pixels
_FRACTION = re.compile(r"(?<![0-9.])[0-9]+\.([0-9]+)(?!\.?[0-9])")
_LONGEST_NAME = 4096  # characters


def read_json(path: Path, *, keeps_null: bool = False) -> dict[str, object]:
    """A JSON object from a file; null is as if left out, unless it is kept.

    Raises:
        FrogError: if the file is missing, not JSON, or not an object.
    """
    data = parsed_json(path, keeps_null=keeps_null)
    if not isinstance(data, dict):
        raise found_instead(path, f"a JSON {type(data).__name__}", "a JSON object")
    return data


def parsed_json(path: Path, *, keeps_null: bool = False) -> object:
    """What a JSON file says, as ``read_json`` does; FrogError if it is missing or not JSON."""
    text = read_text(path, "a JSON file", foreign=True)
    try:
        return json.loads(text, object_hook=None if keeps_null else _without_null)
    except (ValueError, RecursionError) as error:
        reason = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else type(error).__name__
        raise found_instead(path, f"text that is not JSON ({reason})", "a complete JSON file") from error


def records(value: object, path: Path, what: str, expected: str) -> list[dict[str, object]]:
    """``value`` as a list of JSON objects; FrogError for none, and for an empty one."""
    if not isinstance(value, list) or not value or not all(isinstance(entry, dict) for entry in value):
        raise found_instead(path, f"no list of {what}", expected)
    return value


def _without_null(entries: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in entries.items() if value is not None}


def path_inside(folder: Path, value: object, file: Path, what: str) -> Path:
    """The path of a file that ``file`` lists, below a folder; FrogError for one outside of it, and for what is none.

    Of a whole path, as of another computer, the longest end that is there below the folder is taken.
    """
    if not isinstance(value, str) or not value or "\0" in value or len(value) > _LONGEST_NAME:
        raise found_instead(file, f"{brief(repr(value))} as {what}", "the path of a file")
    parts = PurePosixPath(value.replace("\\", "/")).parts
    inside = Path(os.path.normpath(os.path.join(folder, *parts)))
    is_below = Path(os.path.abspath(inside)).is_relative_to(os.path.abspath(folder))
    if PureWindowsPath(value).anchor and ".." not in parts and not (is_below and inside.is_file()):
        ends = (Path(folder, *parts[start:]) for start in range(1, len(parts)))
        inside = next((end for end in ends if end.is_file() or with_ending(end)), inside)
    if not Path(os.path.abspath(inside)).is_relative_to(os.path.abspath(folder)):
        raise FrogError(f"{file}: the {what} {value!r} lies outside the capture's folder, expected one inside.")
    return inside


def numbers(value: object, shape: tuple[int, ...], path: Path, what: str, most: float = MAX_COORDINATE) -> Float64s:
    """``value`` as finite float64 numbers of the given shape, which may be nested in more lists, as OpenCV writes it.

    Args:
        value: of JSON or TOML, where no text, true or false stands for a number; or an array, also of a text's words.

    Raises:
        FrogError: if it is missing, has another shape, or holds a value that is not finite or exceeds ``most``.
    """
    try:
        stored = value if isinstance(value, np.ndarray) else np.asarray(value, dtype=object)
        if stored.dtype == object and not set(map(type, stored.flat)) <= {int, float, np.float64, type(None)}:
            raise TypeError
        with np.errstate(invalid="ignore"):  # some NaN warn when they are converted
            array: Float64s = stored.astype(np.float64)
    except OverflowError as error:  # an integer of hundreds of digits
        raise found_instead(path, f"{what} with a number too large", f"at most {most:g}") from error
    except (TypeError, ValueError) as error:
        raise found_instead(path, f"{what} that is not made of numbers", f"shape {shape}") from error
    if [side for side in array.shape if side != 1] == [side for side in shape if side != 1]:
        array = array.reshape(shape)
    if value is None or array.shape != shape:
        found = "nothing" if value is None else f"shape {array.shape}"
        raise found_instead(path, f"{found} as {what}", f"{' x '.join(map(str, shape)) or 'one'} number(s)")
    if not np.all(np.isfinite(array)):
        raise found_instead(path, f"{what} with a value that is not finite", "finite numbers")
    if np.abs(array).max(initial=0.0) > most:
        raise found_instead(path, f"{what} with the number {np.abs(array).max():g}", f"at most {most:g}")
    return array


def usable_points(points: Array) -> Float64s:
    """Those of the points (N, 3), of any kind of number, that are finite and within the limits; as float64."""
    with np.errstate(invalid="ignore"):  # some NaN warn when they are converted
        converted: Float64s = points.astype(np.float64)
    return np.asarray(converted[(np.abs(converted) <= MAX_COORDINATE).all(axis=1)])  # which leaves out NaN


def number(value: object, path: Path, what: str, *, positive: bool = False, most: float = MAX_COORDINATE) -> float:
    """``value`` as one finite number.

    Raises:
        FrogError: if it is not a number, exceeds ``most``, or is not positive where it must be.
    """
    result = float(numbers(value, (), path, what, most))
    if positive and result <= 0:
        raise found_instead(path, f"{what} = {result:g}", "a positive number")
    return result


def flag(value: object, path: Path, what: str) -> bool:
    """``value`` as true or false, which some write as 1 and 0, and false where it is missing; FrogError for others."""
    if value is not None and value not in (False, True):
        raise found_instead(path, f"{what} = {brief(repr(value))}", "true or false")
    return bool(value)


def size(value: object, path: Path, what: str) -> int:
    """``value`` as an image's width or height in pixels.

    Raises:
        FrogError: if it is not a number between 1 and 65536.
    """
    result = number(value, path, what)
    if not 1 <= result <= MAX_SIDE:
        raise found_instead(path, f"{what} = {result:g}", f"between 1 and {MAX_SIDE} pixels")
    return round(result)


def pinhole(value: object, path: Path, what: str) -> Float64s:
    """``value`` as the matrix K of a camera, (3, 3), with its zeros and its one exactly.

    Raises:
        FrogError: if it is not such a matrix. The message names the usual mistake, a transposed one.
    """
    matrix = numbers(value, (3, 3), path, what)
    exact = exact_pinhole(matrix)
    if exact is None:
        expected = "the rows fx s cx, 0 fy cy and 0 0 1"
        if exact_pinhole(matrix.T) is not None:
            raise found_instead(path, f"{what} that is transposed: its last row is {_row(matrix[2])}", expected)
        raise found_instead(path, f"{what} with the last rows {_row(matrix[1])} and {_row(matrix[2])}", expected)
    if min(matrix[0, 0], matrix[1, 1]) < _MIN_FOCAL:
        raise found_instead(path, f"a focal length of {min(matrix[0, 0], matrix[1, 1]):g} in {what}", "a positive one")
    return exact


def _row(values: Float64s) -> str:
    return " ".join(f"{value:g}" for value in values)


def rigid(value: object, path: Path, what: str) -> Float64s:
    """``value`` as a (4, 4) matrix of a rotation and a translation, with exactly that rotation and the row 0 0 0 1.

    Raises:
        FrogError: if it is not such a matrix. The message names the usual mistake, a transposed one.
    """
    matrix = numbers(value, (4, 4), path, what).copy()
    last = [0.0, 0.0, 0.0, 1.0]
    if not np.allclose(matrix[3], last, atol=1e-3):
        transposed = " that is transposed: its last row is" if np.allclose(matrix[:, 3], last, atol=1e-3) else " with"
        raise found_instead(path, f"{what}{transposed} {_row(matrix[3])}", "the last row 0 0 0 1")
    matrix[:3, :3], matrix[3] = rotation(matrix[:3, :3], path, what), last
    return matrix


def read_table(file: Path, columns: int, most: int, rows: str = "N") -> Array:
    """The numbers (rows, columns) of a ``.npy`` file; FrogError for another shape, or more rows than ``most``."""
    expected = f"numbers of shape ({rows}, {columns})"
    table = read_npy(file, expected, columns * most)
    if table.ndim != 2 or table.shape[1] != columns:
        raise found_instead(file, f"{table.dtype} of shape {table.shape}", expected)
    return table


def frame_span(first: int, last: int, path: Path, what: str) -> int:
    """Number of frames from the first to the last frame number that files or lists name.

    Raises:
        FrogError: if there are more than ``MAX_FRAMES``.
    """
    count = last - first + 1
    if count > MAX_FRAMES:
        raise found_instead(path, f"{what} from {first} to {last}", f"at most {MAX_FRAMES:,} frames")
    return count


def check_images(path: Path, count: int) -> None:
    """FrogError for more than ``MAX_IMAGES``."""
    if count > MAX_IMAGES:
        raise FrogError(f"{path}: found {count:,} images, expected at most {MAX_IMAGES:,}.")


def check_names(names: Sequence[str], path: Path) -> None:
    """FrogError for two cameras of one name."""
    if len(set(names)) < len(names):
        raise found_instead(path, f"several cameras named {max(names, key=names.count)}", "one of each name")


def rotation(matrix: Float64s, path: Path, what: str) -> Float64s:
    """The rotation nearest to a (3, 3) matrix that is a rotation up to rounding.

    Raises:
        FrogError: if the matrix mirrors, scales or shears.
    """
    left, _, right = np.linalg.svd(matrix)
    nearest: Float64s = left @ right
    if np.abs(nearest - matrix).max() > 0.02 or np.linalg.det(nearest) < 0:
        raise found_instead(path, f"{what} that mirrors, scales or shears", "a rotation")
    return nearest


def checked(capture: Capture) -> Capture:
    """A reader's capture, after checks of derived values: numbers that are valid one by one may not be in combination.

    Raises:
        FrogError: for too many images, or a camera whose focal length or position is out of range.
    """
    check_images(capture.path, len(capture.shots))
    for camera in capture.cameras:
        lens, pose = camera.intrinsics, camera.world_to_camera
        far = not (np.abs(lens) <= MAX_COORDINATE).all() or not (np.abs(pose) <= MAX_COORDINATE).all()
        if far or min(lens[0, 0], lens[1, 1]) < _MIN_FOCAL:
            found = f"a focal length of {lens[0, 0]:g} at {_row(pose[:3, 3])} for camera {camera.name}"
            raise found_instead(capture.path, found, f"positive numbers of at most {MAX_COORDINATE:g}")
    capture = replace(capture, warnings=(*capture.warnings, *_alike(capture)))
    middles = [camera.intrinsics[:2, 2] / (camera.width, camera.height) for camera in capture.cameras]
    if shifted := [index for index, middle in enumerate(middles) if np.abs(middle - 0.5).max() > 0.25]:
        first = capture.cameras[shifted[0]]
        said = (
            f"{capture.path}: the principal point of {len(shifted)} of {len(middles)} cameras lies outside the middle "
            f"half of the image ({first.name}: {_row(first.intrinsics[:2, 2])} of {first.width} x {first.height}): "
            "poses or lenses may be wrong, unless the images are crops."
        )
        capture = replace(capture, warnings=(*capture.warnings, said))
    if capture.near_far is not None and not 0 < capture.near_far[0] < capture.near_far[1] <= MAX_COORDINATE:
        return replace(capture, near_far=None)
    return capture


def check_fractions(path: Path, names: Iterable[str]) -> None:
    """FrogError for names of images whose numbers are times with a point (0.25, 0.5): nothing else has as many digits
    as it takes, and no last 0."""
    found = {match[1]: match[0] for name in names for match in _FRACTION.finditer(name)}
    if len({*map(len, found)}) > 1 and not any(len(digits) > 1 and digits[-1] == "0" for digits in found):
        short, long = found[min(found, key=len)], found[max(found, key=len)]
        raise found_instead(path, f"images of the times {short} and {long}", "equally many digits behind the point")


def _alike(capture: Capture) -> Iterator[str]:
    """A sentence where cameras filmed at one time from one place in one direction."""
    spread = float(np.ptp([camera.center for camera in capture.cameras], axis=0).max()) or 1.0
    poses = ([*camera.center / spread, *camera.rotation.flat] for camera in capture.cameras)
    views = [tuple(np.round(pose, 6).tolist()) for pose in poses]
    seen = Counter((shot.frame, views[shot.camera]) for shot in capture.train_shots)
    for (_, view), count in seen.most_common(1):
        first, *others = (camera.name for camera, own in zip(capture.cameras, views, strict=True) if own == view)
        if count > 1:
            yield (
                f"{capture.path}: {first} and {len(others)} more of {len(views)} cameras stand at one place and look "
                "one way, which tells no depth: poses are missing or wrong, or films are there twice."
            )
