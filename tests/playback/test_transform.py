"""Moving a scene as a whole: with the camera moved along, nothing may change in the image."""

from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from support.builders import odd_camera, random_gaussians, rotation_of

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.transform import transform

CAMERA = odd_camera(53, 38)


def placement(rotation: np.ndarray, scale: float, shift: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation * scale, shift
    return matrix


MATRICES = {
    "nothing": np.eye(4),
    "moved": placement(np.eye(3), 1, (3.0, -2.0, 0.5)),
    "scaled": placement(np.eye(3), 2.5, (0, 0, 0)),
    "a quarter turn": placement(rotation_of((0, 0, 1), np.pi / 2), 1, (0, 0, 0)),
    "half a turn": placement(rotation_of((1, 0, 0), np.pi), 1, (0, 0, 0)),
    "half a turn about no axis": placement(rotation_of((1, -2, 0.5), np.pi), 1, (0, 0, 0)),
    "everything": placement(rotation_of((0.2, 1, -0.7), 2.1), 0.6, (-1.0, 4.0, 2.0)),
}


@pytest.mark.parametrize(("name", "degree"), [*zip(MATRICES, cycle([3, 2])), *(("everything", d) for d in range(4))])
def test_the_moved_camera_sees_the_same_image(name: str, degree: int) -> None:
    matrix = MATRICES[name]
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    gaussians = random_gaussians(CAMERA, 150, degree, seed=6).checked()
    moved = transform(gaussians, matrix)
    # A camera is rigid: x_camera = W M^-1 x_moved is the old x_camera; scaled, it must be larger by the scale.
    world_to_camera = np.diag([scale, scale, scale, 1]) @ CAMERA.world_to_camera @ np.linalg.inv(matrix)
    np.testing.assert_allclose(world_to_camera[:3, :3] @ world_to_camera[:3, :3].T, np.eye(3), atol=1e-9)
    found = draw(moved, replace(CAMERA, world_to_camera=world_to_camera), (0.2, 0.2, 0.2))
    expected = draw(gaussians, CAMERA, (0.2, 0.2, 0.2))
    difference = np.abs(found.rgb - expected.rgb).max(axis=2)
    assert np.mean(difference > 2e-4) < 1e-3  # splats' rims may fall on the other side of the cut-off
    assert difference.mean() < 2e-5
    seen = np.isfinite(expected.mean_depth) & (expected.alpha > 0.5)
    np.testing.assert_allclose(found.mean_depth[seen], expected.mean_depth[seen] * scale, rtol=1e-3)


SHEAR, UNEVEN, FLAT, NAN = (np.eye(4) for _ in range(4))
SHEAR[0, 1], UNEVEN[2, 2], FLAT[1, 1], NAN[0, 3] = 0.3, 1.5, 0.0, np.nan


@pytest.mark.parametrize(
    ("matrix", "word"),
    [
        (np.diag([-1.0, 1, 1, 1]), "mirrored"),
        (np.diag([-1.0, -1, -1, 1]), "mirrored"),
        (FLAT, "flattened"),
        (SHEAR, "sheared"),
        (UNEVEN, "unevenly"),
        (NAN, "flattened"),
    ],
)
def test_what_gaussians_cannot_follow_is_refused(matrix: np.ndarray, word: str) -> None:
    with pytest.raises(FrogError, match=word):
        transform(random_gaussians(CAMERA, 3, 1).checked(), matrix)
