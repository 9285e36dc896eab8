"""The rays of Blender's panoramic cameras, as in Cycles. https://docs.blender.org/manual/en/latest/render/cycles"""

import math
from typing import Any

import bpy
import numpy as np

from ..cameras import engine_camera, sensor_of
from ..engine.errors import FrogError
from ..engine.playback.environment import equirectangular


def rays_of(eye: bpy.types.Object, render: Any, width: int, height: int) -> np.ndarray:
    """(H, W, 3) directions in OpenCV's axes of a panoramic camera's pixels, NaN where it sees nothing.

    Args:
        eye: the camera.
        render: settings of the scene, for stereoscopy.
        width, height: of the whole image, pixels.

    Raises:
        FrogError: for a projection that is not drawn.
    """
    data = eye.data
    kind = data.panorama_type
    if render.use_multiview and data.stereo.use_spherical_stereo:
        raise FrogError(f"Camera {eye.name}: found spherical stereo, expected it off: an eye is one point here.")
    if kind == "EQUIRECTANGULAR":
        longitudes, latitudes = (data.longitude_min, data.longitude_max), (data.latitude_min, data.latitude_max)
        return equirectangular(width, height, longitudes, latitudes)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height)
    if kind == "FISHEYE_EQUIDISTANT":
        across, up = 2 * u - 1, 2 * v - 1
        radius = np.hypot(across, up)
        return _fisheye(across, up, np.where(radius <= 1, radius * data.fisheye_fov / 2, np.nan))
    if kind == "FISHEYE_EQUISOLID":
        return _equisolid(data, u, v, width, height)
    if kind == "MIRRORBALL":
        return _mirror_ball(u, v)
    name = kind.replace("_", " ").lower()
    expected = "an equirectangular, equidistant or equisolid one, or a mirror ball"
    raise FrogError(f"Camera {eye.name}: found a panorama of the kind {name}, expected {expected}.")


def check_lens(camera: bpy.types.Object, render: bpy.types.RenderSettings) -> None:
    """Raises FrogError for a camera that FROG does not draw."""
    if camera.type == "CAMERA" and camera.data.type == "PANO":
        rays_of(camera, render, 4, 4)
    else:
        engine_camera(camera, camera.matrix_world, render, 64, 64)


def _fisheye(across: np.ndarray, up: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rays at an angle to the axis, in the direction of (across, up) in the image."""
    radius = np.maximum(np.hypot(across, up), 1e-12)
    side = np.sin(angle) / radius
    return np.stack([side * across, -side * up, np.cos(angle)], axis=-1)


def _equisolid(data: Any, u: np.ndarray, v: np.ndarray, width: int, height: int) -> np.ndarray:
    """The sensor's side that the camera does not fit follows from the image's proportions."""
    sensor, length = sensor_of(data, width, height)
    pixel = sensor / length
    across, up = (u - 0.5) * width * pixel, (v - 0.5) * height * pixel
    radius, lens = np.hypot(across, up), data.fisheye_lens
    seen = radius <= 2 * lens * math.sin(min(data.fisheye_fov, 2 * math.pi) / 4)
    return _fisheye(across, up, 2 * np.arcsin(np.where(seen, radius / (2 * lens), np.nan)))


def _mirror_ball(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Directions as a mirroring ball shows them: straight ahead in its middle, what lies behind along its edge."""
    x, z = 2 * u - 1, 2 * v - 1
    inside = x * x + z * z <= 1
    depth = np.sqrt(np.where(inside, 1 - x * x - z * z, np.nan))
    return np.stack([2 * depth * x, -2 * depth * z, 2 * depth * depth - 1], axis=-1)
