"""The order of importance: fixed, sensible, and a scene of the first of it is the same scene with less in it."""

import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.importance import most_important, ranking
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw


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
