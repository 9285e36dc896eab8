"""Converts engine cameras to Blender cameras and back, exactly. No other file knows both conventions.

Blender looks along -z with y up and describes a lens by focal length, sensor and shift; the engine looks along +z with
y down and describes it by a matrix of pixels.  What Blender cannot hold in a camera, pixels that are not square, is
kept in a property of the camera (``Camera.frog.focal_ratio``) that the FROG engine honours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .engine.capture.camera import Camera
from .engine.errors import FrogError

if TYPE_CHECKING:
    import bpy

SENSOR_WIDTH = 36.0  # millimetres; any value does, the focal length follows from it
_FAR = 1000.0  # widths of what is seen
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV axes <-> Blender axes


def lens_of(camera: Camera) -> dict[str, float]:
    """Blender's ``lens`` (millimetres), ``shift_x``, ``shift_y`` and our ``focal_ratio`` (fy / fx) of an engine camera.

    They hold for a horizontal sensor of SENSOR_WIDTH, rendered at the camera's own size with square pixels.
    """
    k = camera.intrinsics
    width, height = camera.width, camera.height
    return {
        "lens": k[0, 0] * SENSOR_WIDTH / width,
        "shift_x": (width / 2 - k[0, 2]) / width,
        "shift_y": (k[1, 2] - height / 2) / width,
        "focal_ratio": k[1, 1] / k[0, 0],
    }


def apply_lens(data: bpy.types.Camera, camera: Camera) -> None:
    """Give a Blender camera datablock the lens of an engine camera."""
    lens = lens_of(camera)
    data.type = "PERSP"
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = SENSOR_WIDTH
    data.sensor_height = SENSOR_WIDTH * camera.height / camera.width
    data.lens, data.shift_x, data.shift_y = lens["lens"], lens["shift_x"], lens["shift_y"]
    data.frog.focal_ratio = lens["focal_ratio"]
    data.frog.size = (camera.width, camera.height)


def pose_of(camera: Camera) -> np.ndarray:
    """(4, 4) matrix that places a Blender camera: camera axes of Blender to world."""
    return np.linalg.inv(camera.world_to_camera) @ _FLIP


def view_matrix_of(matrix_world: Any, name: str, back: float = 0.0) -> np.ndarray:
    """(4, 4) ``world_to_camera`` of what stands as a Blender camera of that matrix does, its scale left out.

    FrogError, with the name, for a matrix that places nothing.

    Args:
        back: how far it is moved back.
    """
    pose = np.array(matrix_world, dtype=np.float64)
    _expect_numbers(pose, name)
    left, scales, right = np.linalg.svd(pose[:3, :3])
    if scales[-1] < 1e-12 or np.linalg.det(pose[:3, :3]) < 0:
        raise FrogError(f"{name}: found a mirrored or zero scale, expected a positive one.")
    pose[:3, :3] = left @ right  # the closest rotation: a parent's scale does not affect what a camera sees
    pose[:3, 3] += back * pose[:3, 2]
    return np.linalg.inv(pose @ _FLIP)


def engine_camera(
    obj: bpy.types.Object,
    matrix_world: Any,
    render: bpy.types.RenderSettings,
    width: int,
    height: int,
    shift_x: float | None = None,
) -> Camera:
    """Converts a (possibly evaluated) Blender camera object to an engine camera, at a render size in pixels.

    ``matrix_world`` is the object's, ``render`` the scene's render settings (for the pixel aspect). An orthographic
    camera stands ``distance_added`` further back than Blender's. An eye of a stereoscopic camera has a ``shift_x``
    and a matrix of its own.
    Raises FrogError for a lens that is neither perspective nor orthographic.
    """
    data = obj.data
    if obj.type != "CAMERA" or data.type not in ("PERSP", "ORTHO"):
        kind = data.type.lower() if obj.type == "CAMERA" else obj.type.lower()
        raise FrogError(f"Camera {obj.name}: found a {kind} lens, expected a perspective or an orthographic one.")
    aspect = render.pixel_aspect_y / render.pixel_aspect_x
    sensor, view = sensor_of(data, width, height * aspect)
    far = distance_added(data)
    focal = view / data.ortho_scale * far if far else data.lens / sensor * view
    intrinsics = np.array(
        [
            [focal, 0.0, width / 2 - (data.shift_x if shift_x is None else shift_x) * view],
            [0.0, focal * data.frog.focal_ratio / aspect, height / 2 + data.shift_y * view / aspect],
            [0.0, 0.0, 1.0],
        ]
    )
    _expect_lens(intrinsics, f"Camera {obj.name}")
    return Camera(obj.name, width, height, intrinsics, view_matrix_of(matrix_world, f"Camera {obj.name}", far))


def sensor_of(data: bpy.types.Camera, width: float, height: float) -> tuple[float, float]:
    """A camera's sensor, millimetres, and what it spans: the width or the height of the image, both in widths of a
    pixel.
    """
    is_wide = width >= height if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL"
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    return sensor, width if is_wide else height


def distance_added(data: bpy.types.Camera) -> float:
    """How far the engine camera is moved back: very far for an orthographic camera, so that its image is the same to
    a pixel; 0 for a perspective camera.
    """
    return _FAR * data.ortho_scale if data.type == "ORTHO" else 0.0


def view_camera(view_matrix: Any, window_matrix: Any, width: int, height: int, focal_ratio: float = 1.0) -> Camera:
    """The engine camera of a 3D viewport, from its region's matrices, at a size in pixels.

    An orthographic view is one from very far away, as for ``engine_camera``.
    """
    view, window = np.array(view_matrix, np.float64), np.array(window_matrix, np.float64)
    _expect_numbers(np.stack([view, window]), "The viewport")
    intrinsics, distance = np.diag([window[0, 0] * width / 2, window[1, 1] * height * focal_ratio / 2, 1.0]), 0.0
    _expect_lens(intrinsics, "The viewport")
    if window[3, 3] == 0.0:  # perspective: clip w is the depth
        intrinsics[:2, 2] = (1 - window[0, 2]) * width / 2, (1 + window[1, 2]) * height / 2
    else:
        distance = _FAR * 2 / window[1, 1]
        intrinsics[:2] *= distance
        intrinsics[:2, 2] = (1 + window[0, 3]) * width / 2, (1 - window[1, 3]) * height / 2
    return Camera("viewport", width, height, intrinsics, view_matrix_of(np.linalg.inv(view), "The viewport", distance))


def _expect_numbers(values: np.ndarray, name: str) -> None:
    if not np.isfinite(values).all():
        raise FrogError(f"{name}: found non-finite values in its lens or position, expected finite ones.")


def _expect_lens(intrinsics: np.ndarray, name: str) -> None:
    _expect_numbers(intrinsics, name)
    if not (np.diag(intrinsics) > 0).all():
        raise FrogError(f"{name}: found a focal length of zero or less, expected a positive one.")
