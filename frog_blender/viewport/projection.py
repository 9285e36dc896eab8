"""What the shader has to know of a view: the FROG engine's own camera of it, seen from a capture's own space."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine.capture.camera import Camera
from ..engine.native.options import RasterizeOptions

NEAR = RasterizeOptions().near_plane


@dataclass(frozen=True, eq=False)
class SplatView:
    """A view of a capture.

    Attributes:
        to_camera: (4, 4) from the capture's space to the camera's (x right, y down, z forward), its scale included.
        lens: fx, fy, cx, cy in pixels.
        size: width and height of the image in pixels.
        eye: (3,) the camera's centre in the capture's space.
        clip: what turns a depth z into Blender's clip space: (a z + b) / (c z + d) is the normalised depth.
    """

    to_camera: np.ndarray
    lens: tuple[float, float, float, float]
    size: tuple[int, int]
    eye: np.ndarray
    clip: tuple[float, float, float, float]

    @property
    def plane(self) -> tuple[float, float, float, float]:
        """A point's depth is the first three times it, plus the last."""
        x, y, z, w = self.to_camera[2].tolist()
        return x, y, z, w


def view_of(camera: Camera, matrix_world: np.ndarray, view_matrix: Any, window_matrix: Any) -> SplatView:
    """The view of a capture that stands at ``matrix_world`` (rotation, uniform scale, translation).

    Args:
        camera: the engine's, of ``cameras.view_camera`` with the matrices.
    """
    view, window = np.array(view_matrix, np.float64), np.array(window_matrix, np.float64)
    to_camera = camera.world_to_camera @ matrix_world
    eye = np.linalg.inv(matrix_world) @ np.append(camera.center, 1.0)
    k = camera.intrinsics
    added = camera.world_to_camera[2, 3] + view[2, 3]  # how far an orthographic view was moved back
    # Blender looks along -z: its z is added - depth.
    clip = (-window[2, 2], window[2, 2] * added + window[2, 3], -window[3, 2], window[3, 2] * added + window[3, 3])
    return SplatView(to_camera, (k[0, 0], k[1, 1], k[0, 2], k[1, 2]), (camera.width, camera.height), eye[:3], clip)
