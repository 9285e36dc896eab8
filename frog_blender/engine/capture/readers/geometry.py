"""Cameras from the parameters that calibrations state, in the project's convention (see ``camera``)."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ...gaussians import rotation_terms
from ..camera import Camera, rotation_about
from ..capture import Distortion
from ..lenses import FISHEYE, pinhole_for
from ..orientation import turned_camera
from ..video import VideoFacts
from .checks import numbers, pinhole, rotation

_PROPORTIONS = 0.02  # relative difference of two aspect ratios that rounded sizes explain
_TRANSPOSED = 0.01
OPENGL_AXES = np.diag([1.0, -1.0, -1.0])
"""(3, 3) from OpenCV's axes to OpenGL's (x right, y up, looking along -z), and back."""
Calibrated = tuple[Camera, Distortion | None]
"""A camera at its calibrated size, with its lens."""


def intrinsics(focal_x: float, focal_y: float, center_x: float, center_y: float) -> Float64s:
    """(3, 3) matrix K of focal lengths and a principal point in pixels."""
    return np.array([[focal_x, 0.0, center_x], [0.0, focal_y, center_y], [0.0, 0.0, 1.0]])


def pose(world_to_camera_rotation: Float64s, center: Float64s) -> Float64s:
    """(4, 4) world-to-camera matrix of a rotation (3, 3) and a camera centre (3,) in world units."""
    matrix = np.eye(4)
    matrix[:3, :3] = world_to_camera_rotation
    matrix[:3, 3] = -world_to_camera_rotation @ center
    return matrix


def distortion(coefficients: Float64s, skew: float = 0.0) -> Distortion | None:
    """See ``Distortion``; None where the lens needs no correction."""
    return Distortion(coefficients, skew) if skew or np.any(coefficients) else None


def is_transposed(size: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether one of two sizes (width, height) has the proportions of the other turned by 90 degrees, not its own."""
    upright, lying = size[0] * other[1] / (size[1] * other[0]), size[0] * other[0] / (size[1] * other[1])
    return abs(lying - 1) < _TRANSPOSED < abs(upright - 1)


def same_proportions(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes (width, height) have the same aspect ratio, to 2 %."""
    return abs(size[0] * other[1] / (size[1] * other[0]) - 1) <= _PROPORTIONS


def as_shown(camera: Camera, lens: Distortion | None, film: VideoFacts) -> Calibrated:
    """The camera of a film's images as they are shown, where it was calibrated on them as they are stored, before they
    were turned, or with pixels that are not square; every other one as it is."""
    size, shown, stored = (camera.width, camera.height), (film.width, film.height), film.stored
    if film.turn % 180 and is_transposed(size, stored):
        shown, stored = shown[::-1], stored[::-1]
    if film.header.aspect != 1 and same_proportions(size, stored) and not same_proportions(size, shown):
        camera = camera.resized(*shown)
    if film.turn % 180 and is_transposed((film.width, film.height), (camera.width, camera.height)):
        return turned_camera(camera, lens, film.turn // 90) or (camera, lens)
    return camera, lens


def opencv_camera(
    name: str, size: tuple[int, int], values: Mapping[str, object], path: Path, *, is_fisheye: bool = False
) -> Calibrated:
    """A camera that a calibration describes as OpenCV does, and its lens.

    Args:
        size: width and height in pixels.
        values: what the calibration calls K (3 x 3), rotation (see ``vector_or_matrix``), translation and distortion,
            in this order; rotation and translation take the world to the camera.
        path: the calibration, for the sentence.
        is_fisheye: the distortion is that of ``cv2.fisheye``.

    Raises:
        FrogError: for a value that cannot be used.
    """
    (of_matrix, matrix), (of_turn, turn), (of_shift, shift), (of_lens, lens) = values.items()
    intrinsics = pinhole(matrix, path, f"{of_matrix} of camera {name}").copy()
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = vector_or_matrix(turn, path, f"{of_turn} of camera {name}")
    world_to_camera[:3, 3] = numbers(flat(shift), (3,), path, f"{of_shift} of camera {name}")
    lens = flat(lens or [])
    count = len(lens) if isinstance(lens, list) else 0
    coefficients = numbers(lens, (count,), path, f"{of_lens} of camera {name}")
    if count < 4 if is_fisheye else count not in (0, 4, 5, 8, 12, 14):  # what OpenCV takes
        expected = "4 of a fisheye" if is_fisheye else "4, 5, 8, 12 or 14"
        raise found_instead(path, f"{count} distortion coefficients for camera {name}", expected)
    skew, intrinsics[0, 1] = intrinsics[0, 1] / intrinsics[0, 0], 0.0
    camera = Camera(name, *size, intrinsics, world_to_camera)
    if is_fisheye:
        return through_lens(camera, FISHEYE, coefficients[:4], path)
    return camera, distortion(coefficients if count else np.zeros(5), skew)


def vector_or_matrix(value: object, path: Path, what: str) -> Float64s:
    """The rotation (3, 3) that is listed as such, or as a vector about which it turns by its length in radians;
    FrogError for none."""
    vector = flat(value)
    if isinstance(vector, list) and len(vector) == 3:
        return rotation_about(numbers(vector, (3,), path, what, 100.0))
    return rotation(numbers(value, (3, 3), path, what), path, what)


def flat(value: object) -> object:
    """A list of numbers that is nested in others, as a row or a column of a matrix."""
    while isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        value = [entry for row in value for entry in row]
    return value


def through_lens(camera: Camera, model: str, coefficients: Float64s, path: Path) -> tuple[Camera, Distortion]:
    """The pinhole camera in place of one with a wide lens, and what makes its images of the stored ones.

    Args:
        camera: with the K that the calibration gives for the lens.
        model, coefficients: see ``lenses``.
        path: the calibration, for the sentence.

    Raises:
        FrogError: for a lens that no pinhole camera can take the place of.
    """
    size = camera.width, camera.height
    matrix = pinhole_for(model, coefficients, camera.intrinsics, size)
    if matrix is None:
        shown = " ".join(f"{value:g}" for value in coefficients)
        found = f"a lens ({model}, {shown}) of camera {camera.name} that shows no image"
        raise found_instead(path, found, "a real one")
    lens = np.diag([1 / size[0], 1 / size[1], 1.0]) @ camera.intrinsics
    return replace(camera, intrinsics=matrix), Distortion(coefficients, 0.0, model, lens)


def from_quaternion(values: Float64s, path: Path, what: str) -> Float64s:
    """(3, 3) rotation of a quaternion w x y z.

    Raises:
        FrogError: for one whose length is not 1.
    """
    length = float(np.linalg.norm(values))
    if abs(length - 1) > 0.02:
        raise found_instead(path, f"{what}, a quaternion of length {length:g}", "one of length 1")
    return np.asarray(rotation_terms(*values / length)).reshape(3, 3)
