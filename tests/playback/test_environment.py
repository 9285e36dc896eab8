"""Light from a scene: where it is taken, which direction it comes from, and what fills its holes."""

from functools import partial

import numpy as np
import pytest
from support.builders import blobs

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.environment import environment, equirectangular, filled, free_place
from frog_blender.engine.srgb import srgb_to_linear

balls = partial(blobs, scales=0.3, opacities=0.99)
"""Round and nearly opaque Gaussians."""


def shell(rows=12, columns=24, radius=3.0):
    """Directions of Gaussians all around."""
    rays = equirectangular(columns, rows).reshape(-1, 3)
    return rays * radius


def pixel_of(image, direction):
    height, width = image.shape[:2]
    cosines = equirectangular(width, height) @ (np.array(direction) / np.linalg.norm(direction))
    return image[np.unravel_index(cosines.argmax(), cosines.shape)]


def test_light_comes_from_where_it_was_filmed_and_is_linear():
    ends = {(3, 0, 0): (0.9, 0.1, 0.1), (0, 3, 0): (0.1, 0.8, 0.2), (0, 0, 3): (0.2, 0.3, 0.7)}
    ends |= {(-3, 0, 0): (0.6, 0.6, 0.1), (0, -3, 0): (0.7, 0.2, 0.6), (0, 0, -3): (0.5, 0.5, 0.5)}
    image = environment(balls(list(ends), scales=0.8, colors=list(ends.values())), np.eye(4), 64)
    assert image.shape == (32, 64, 3) and image.dtype == np.float32
    for direction, color in ends.items():
        np.testing.assert_allclose(pixel_of(image, direction), srgb_to_linear(np.array(color)), atol=0.03)


def test_the_camera_decides_what_is_ahead():
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # looks along +x, z is up
    turn[:3, 3] = -turn[:3, :3] @ [5.0, 6.0, 7.0]
    image = environment(balls([[8, 6, 7], [5, 3, 7]], colors=[[1, 0, 0], [0, 1, 0]]), turn, 64)
    assert pixel_of(image, (0, 0, 1))[0] > 0.9
    assert pixel_of(image, (1, 0, 0))[1] > 0.9, "-y is at the right"


def test_holes_have_the_colour_around_them():
    everywhere = shell()
    warm = np.tile([0.8, 0.5, 0.3], (len(everywhere), 1))
    hole = everywhere @ [0, 0, 1] > 2.0
    image = environment(balls(everywhere[~hole], colors=warm[~hole]), np.eye(4), 64)
    np.testing.assert_allclose(image, np.broadcast_to(srgb_to_linear(np.array(warm[0])), image.shape), atol=0.02)


def test_a_hole_is_filled_from_its_own_side_across_the_seam():
    colors = np.zeros((32, 64, 3))
    colors[:, :16] = colors[:, 48:] = (1, 0, 0)  # behind
    colors[:, 16:48] = (0, 0, 1)
    weights = np.ones((32, 64))
    weights[12:20, :4] = weights[12:20, 60:] = 0  # on both sides of the seam
    colors[weights == 0] = np.nan_to_num(np.inf)
    kept = weights == 1
    result = filled(np.where(kept[..., None], colors, 0), weights)
    np.testing.assert_allclose(result[kept], colors[kept], atol=1e-6)
    np.testing.assert_allclose(result[~kept], np.tile([1, 0, 0], ((~kept).sum(), 1)), atol=0.1)


def test_nothing_to_see_is_said():
    with pytest.raises(FrogError, match="No Gaussian is seen"):
        environment(blobs([[0, 0, 3]], opacities=0.0), np.eye(4), 16)
    with pytest.raises(ValueError, match="power of two"):
        environment(balls([[0, 0, 3]]), np.eye(4), 100)


def test_light_is_not_taken_inside_of_something():
    subject = np.random.default_rng(1).normal(0, 0.1, (300, 3))
    scene = balls(np.concatenate([subject, shell()]), scales=0.05)
    place = free_place(scene, np.zeros(3), 3.0)
    assert 0.3 < np.linalg.norm(place) < 2.0
    assert np.linalg.norm(scene.means - place, axis=1).min() > 0.3
    empty = balls(shell())
    np.testing.assert_array_equal(free_place(empty, np.zeros(3), 3.0), np.zeros(3))
