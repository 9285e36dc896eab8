"""LLFF's ``poses_bounds.npy``, which N3DV and 4DGaussians' multipleview captures have.

A row is a 3 x 5 matrix [R | t | (H, W, f)], camera-to-world, followed by near and far. The columns of R are LLFF's axes
(down, right, backwards). The principal point is the image's centre. (Fyusion/LLFF, README.)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ...io.numpy_files import read_npy
from ..camera import Camera
from .checks import numbers, rotation
from .geometry import intrinsics, pose

_MAX_CAMERAS = 10_000


def read_rows(path: Path) -> Float64s:
    """(N, 17) float64 rows, checked.

    Raises:
        FrogError: for a file of another shape, or a value that cannot be used.
    """
    stored = read_npy(path, "numbers of shape (cameras, 17)", 17 * _MAX_CAMERAS)
    if stored.ndim != 2 or stored.shape[1] != 17:
        raise found_instead(path, f"{stored.dtype} of shape {stored.shape}", "numbers of shape (cameras, 17)")
    rows = np.array([numbers(row, (17,), path, f"row {index}") for index, row in enumerate(stored)]).reshape(-1, 17)
    bad = np.flatnonzero((rows[:, [4, 9, 14]] <= 0).any(axis=1))
    if bad.size:
        raise found_instead(
            path, f"a height, width or focal length of zero or less in row {bad[0]}", "positive numbers"
        )
    return rows


def row_camera(row: Float64s, name: str, size: tuple[int, int], path: Path) -> Camera:
    """The OpenCV camera of one row, at the size (width, height) of its decoded frames.

    Raises:
        FrogError: for axes that are no rotation.
    """
    matrix = row[:15].reshape(3, 5)
    down, right, backwards = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    camera_to_world = rotation(np.stack([right, down, -backwards], axis=1), path, f"the pose of {name}")
    (stored_height, stored_width, focal), (width, height) = matrix[:, 4], size
    focal_x, focal_y = focal * width / stored_width, focal * height / stored_height
    lens = intrinsics(focal_x, focal_y, width / 2, height / 2)
    return Camera(name, width, height, lens, pose(camera_to_world.T, matrix[:, 3]))
