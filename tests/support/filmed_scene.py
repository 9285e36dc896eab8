"""One small scene, filmed by four cameras at five times, from which the tests write every layout of captures.

A wall and a square that slides before it, coloured by smooth functions of the place, so that every ray has an exact
colour: through a pinhole, a distorting lens or a fisheye.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import cv2
import numpy as np
from support.builders import rotation_of

from frog_blender.engine.capture.camera import Camera

FRAMES, WIDTH, HEIGHT = 5, 64, 48
NAMES = ("cam00", "cam01", "cam02", "cam03")
_WALL, _SQUARE = 6.0, 4.5  # depths, world units
Rays = Callable[[np.ndarray], np.ndarray]


def rig(focal: tuple[float, float] = (52.0, 54.0), center: tuple[float, float] = (33.5, 22.25)) -> list[Camera]:
    """Four cameras side by side that look at the wall, each turned a little, none aligned with an axis."""
    matrix = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
    cameras = []
    for index, name in enumerate(NAMES):
        pose = np.eye(4)
        pose[:3, :3] = rotation_of((0.2, 1, 0.1 * index), 0.12 * (1.5 - index))
        pose[:3, 3] = -pose[:3, :3] @ np.array([1.2 * (index - 1.5), 0.2 * (-1) ** index, 0.3 * index])
        cameras.append(Camera(name, WIDTH, HEIGHT, matrix, pose))
    return cameras


def moving(count: int = FRAMES) -> list[Camera]:
    """One camera that moves on from frame to frame."""
    cameras = []
    for index in range(count):
        pose = np.eye(4)
        pose[:3, :3] = rotation_of((0.1, 1, 0.3), 0.05 * (index - 2))
        pose[:3, 3] = -pose[:3, :3] @ np.array([0.3 * (index - 2), 0.1 * index, 0.05 * index])
        cameras.append(Camera(f"view{index}", WIDTH, HEIGHT, rig()[0].intrinsics, pose))
    return cameras


def image(camera: Camera, frame: int, rays: Rays | None = None) -> np.ndarray:
    """(H, W, 3) uint8 RGB at a frame.

    Args:
        rays: pixel positions (N, 2) to directions (x, y, 1), as (N, 2); those of the camera's pinhole by default.
    """
    across, down = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([across.ravel(), down.ravel()], axis=1)
    if rays is None:
        flat = (pixels - camera.intrinsics[:2, 2]) / camera.intrinsics.diagonal()[:2]
    else:
        flat = rays(pixels)
    directions = np.concatenate([flat, np.ones((len(flat), 1))], axis=1) @ camera.rotation
    return _colors(camera.center, directions, frame).reshape(camera.height, camera.width, 3)


def bent_rays(camera: Camera, coefficients: Sequence[float], skew: float = 0.0) -> Rays:
    """The rays of an image that OpenCV's distortion bends, and skew of so many pixels shears."""

    def rays(pixels: np.ndarray) -> np.ndarray:
        flat = (pixels - camera.intrinsics[:2, 2]) / camera.intrinsics.diagonal()[:2]
        flat[:, 0] -= skew / camera.intrinsics[0, 0] * flat[:, 1]
        exact, known = (3, 100, 1e-12), (np.eye(3), np.array(coefficients), None, None)
        return cv2.undistortPointsIter(flat[:, None], *known, exact)[:, 0]

    return rays


@lru_cache(maxsize=64)
def still(name: str, frame: int) -> np.ndarray:
    """The image of a camera of ``rig()`` by its name."""
    return image(next(camera for camera in rig() if camera.name == name), frame)


def _colors(origin: np.ndarray, directions: np.ndarray, frame: int) -> np.ndarray:
    wall = origin + directions * ((_WALL - origin[2]) / directions[:, 2])[:, None]
    near = origin + directions * ((_SQUARE - origin[2]) / directions[:, 2])[:, None]
    on_square = near[:, :2] - np.array([-1.0 + 0.5 * frame, 0.2 * frame - 0.4])
    inside = 1 / (1 + np.exp(14 * np.minimum(np.abs(on_square).max(axis=1) - 0.7, 9)))  # its edge is soft
    u, v = wall[:, 0], wall[:, 1]
    back = np.stack([np.sin(1.7 * u + 0.4 * v), np.sin(2.3 * v + 1), np.cos(1.1 * u - 1.9 * v)], axis=1)
    u, v = on_square[:, 0], on_square[:, 1]
    front = np.stack([np.cos(4 * u), np.sin(5 * v + 0.5), np.sin(3 * u + 4 * v)], axis=1)
    mixed = back * (1 - inside[:, None]) + front * inside[:, None]
    return np.round(127.5 + 70 * mixed).astype(np.uint8)
