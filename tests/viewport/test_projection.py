"""What the shader is told of a view: where a point lies in the image, how deep, and seen from where."""

import numpy as np
import pytest
from support.builders import rotation_of

from frog_blender.cameras import view_camera
from frog_blender.viewport.projection import view_of

SIZE = (160, 90)
NEAR, FAR = 0.1, 500.0


def placed(rotation: np.ndarray, place: tuple[float, float, float], scale: float = 1.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation * scale, place
    return matrix


def window(kind: str) -> np.ndarray:
    matrix = np.zeros((4, 4))
    if kind == "perspective":
        matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = 1.8, 3.2, 0.1, -0.05
        matrix[2, 2], matrix[2, 3] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
        matrix[3, 2] = -1
    else:
        matrix[0, 0], matrix[1, 1], matrix[0, 3] = 0.2, 0.35, 0.1
        matrix[2, 2], matrix[2, 3], matrix[3, 3] = -1 / FAR, 0.0, 1.0
    return matrix


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
@pytest.mark.parametrize("scale", [1.0, 0.02, 7.0])
def test_a_point_is_where_blender_draws_it(kind: str, scale: float) -> None:
    eye = placed(rotation_of((1.2, 0.1, 0.4), 1.3), (1.0, -6.0, 2.0))
    world = placed(rotation_of((0.3, -0.2, 1.0), 1.1), (0.5, 0.3, 0.1), scale)
    view_matrix, window_matrix = np.linalg.inv(eye), window(kind)
    view = view_of(view_camera(view_matrix, window_matrix, *SIZE), world, view_matrix, window_matrix)
    points = np.c_[np.random.default_rng(1).uniform(-1, 1, (100, 3)) / scale, np.ones(100)]
    clip = points @ (window_matrix @ view_matrix @ world).T
    clip = clip[:, :3] / clip[:, 3:]
    local = points @ view.to_camera.T
    fx, fy, cx, cy = view.lens
    found = np.stack([fx * local[:, 0] / local[:, 2] + cx, fy * local[:, 1] / local[:, 2] + cy], axis=1)
    expected = np.stack([(clip[:, 0] + 1) * SIZE[0] / 2, (1 - clip[:, 1]) * SIZE[1] / 2], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-6 if kind == "perspective" else 0.1)
    a, b, c, d = view.clip
    depth = (a * local[:, 2] + b) / (c * local[:, 2] + d)
    np.testing.assert_allclose(depth, clip[:, 2], atol=1e-6)
    np.testing.assert_allclose(local[:, 2], points @ np.array(view.plane), atol=1e-9)
    if kind == "perspective":  # another view is one from very far away
        np.testing.assert_allclose((world @ np.append(view.eye, 1.0))[:3], eye[:3, 3], atol=1e-9, err_msg="the eye")
