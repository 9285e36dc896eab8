"""Parts of a scene in the order of importance, and a scene moved as a whole: each shows what it must."""

from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from support.builders import odd_camera, random_gaussians, refused, rotation_of, scene_file

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.importance import most_important, ranking
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.transform import transform


def test_it_is_an_order_and_always_the_same() -> None:
    scene = ScenePlayer(scene_file(200))
    order = ranking(scene)
    np.testing.assert_array_equal(np.sort(order), np.arange(200))
    np.testing.assert_array_equal(order, ranking(ScenePlayer(scene_file(200))))
    halves = [set(most_important(order, count)) for count in (20, 100, 200)]
    assert halves[0] < halves[1] < halves[2] and len(most_important(order, 0)) == 1


def test_what_hardly_shows_comes_last() -> None:
    """Ten are made nearly transparent, ten tiny, ten put where no camera looks."""
    scene = scene_file(90)
    scene.arrays["opacity_logits"][:10] = -9
    scene.arrays["log_scales"][10:20] = -9
    scene.arrays["means"][20:30] += 300
    place = np.argsort(ranking(ScenePlayer(scene)))
    assert place[:20].min() > 55 and place[20:30].mean() > place[30:].mean() + 10


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_the_first_of_it_are_worth_more_than_their_share(share: float) -> None:
    scene = ScenePlayer(scene_file(300, seed=3))
    count, camera = int(300 * share), scene.header.cameras[0]
    order = ranking(scene)
    whole = draw(scene.at_frame(4), camera).rgb

    def error(kept: np.ndarray) -> float:
        return float(np.abs(draw(scene.subset(kept).at_frame(4), camera).rgb - whole).mean())

    random = np.random.default_rng(0)
    others = [error(np.sort(random.permutation(300)[:count])) for _ in range(5)]
    assert error(most_important(order, count)) < 0.8 * min(others)


@pytest.mark.parametrize("moving", [None, 40, 5])
def test_fewer_of_them_are_as_they_were(moving: int | None) -> None:
    scene = ScenePlayer(scene_file(100, moving=moving, sh_count=9))
    kept = np.sort(np.random.default_rng(1).permutation(100)[:37])
    fewer = scene.subset(kept)
    assert (fewer.count, fewer.num_dynamic) == (37, int((kept < scene.num_dynamic).sum()))
    for frame in (0, 2.5, 6):
        before, after = scene.at_frame(frame), fewer.at_frame(frame)
        for name in ATTRIBUTES:
            np.testing.assert_allclose(getattr(after, name), getattr(before, name)[kept], rtol=1e-5, atol=1e-6)


def test_none_of_those_that_move() -> None:
    scene = ScenePlayer(scene_file(50, moving=20))
    fewer = scene.subset(np.arange(25, 50))
    assert fewer.num_dynamic == 0 and not fewer.changing
    np.testing.assert_allclose(fewer.at_frame(5).means, scene.at_frame(2).means[25:], atol=1e-6)


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
    refused(word, transform, random_gaussians(CAMERA, 3, 1).checked(), matrix)
