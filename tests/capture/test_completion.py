from dataclasses import replace

import numpy as np
from support.builders import plain_camera

from frog_blender.engine.capture.seeding.plane_sweep import DepthMap, completed, points_seen_once
from frog_blender.engine.capture.seeding.views import View

WIDTH, HEIGHT = 80, 60
LINES, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]


def view_at(x: float, image: np.ndarray) -> View:
    camera = plain_camera(WIDTH, HEIGHT, 60.0).moved(np.zeros(3), np.array([-x, 0, 0]))
    return View(0, camera, image.astype(np.float32))


def depth_map(view: View, depth: np.ndarray, confirmed: np.ndarray) -> DepthMap:
    sure = np.ones(depth.shape, bool)
    return DepthMap(view, np.asarray(depth, np.float64), sure, sure, 0.01, confirmed)


def test_a_floor_goes_on_where_no_other_view_confirms_it() -> None:
    floor, seen = 1 / (0.1 + 0.002 * LINES), COLUMNS < 50
    mixed = np.where(seen, floor, 30.0)  # a wrong match beyond
    filled = completed(depth_map(view_at(0, np.full((HEIGHT, WIDTH, 3), 0.5)), mixed, seen))
    np.testing.assert_array_equal(filled[seen], floor[seen])
    wrong, one_depth = (np.abs(depth / floor - 1)[~seen] for depth in (filled, np.median(floor)))
    assert np.median(wrong) < min(0.06, np.median(one_depth) / 2)


def test_depth_does_not_flow_across_an_edge_of_the_image() -> None:
    """A dark card before a bright wall; the strip of wall beside it is hidden from the others."""
    card = (COLUMNS >= 30) & (COLUMNS < 50)
    truth = np.where(card, 2.0, 8.0)
    hidden = (COLUMNS >= 50) & (COLUMNS < 60)
    image = np.repeat(np.where(card, 0.1, 0.9)[..., None], 3, axis=2)
    filled = completed(depth_map(view_at(0, image), np.where(hidden, 1.0, truth), ~hidden))
    assert (filled[hidden] > 5.5).mean() > 0.95
    blank = depth_map(view_at(0, np.full(image.shape, 0.5)), np.where(hidden, 1.0, truth), ~hidden)
    assert (completed(blank)[hidden] > 5.5).mean() < 0.5, "it is the image that stops it"


def test_no_point_hides_what_another_camera_confirms() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 0.5)
    wall, near = np.full((HEIGHT, WIDTH), 6.0), np.full((HEIGHT, WIDTH), 3.0)
    left = COLUMNS < 40
    own = depth_map(view_at(0, image), near, left)
    alone = points_seen_once(own, [])
    assert len(alone) == len(alone.colors) == alone.is_textured.sum() == (~left).sum()
    np.testing.assert_allclose(alone.points[:, 2], 3, rtol=0.02)
    sure = depth_map(view_at(0.1, image), wall, np.ones(left.shape, bool))
    pixels, _ = sure.view.camera.project(points_seen_once(own, [sure]).points)
    outside = ((pixels < 0) | (pixels >= [WIDTH, HEIGHT])).any(axis=1)
    assert outside.all(), "the other camera sees the wall there, through these"
    nothing = np.zeros(left.shape, bool)
    assert len(points_seen_once(own, [replace(sure, confirmed=nothing)])) == len(alone)
    assert not len(points_seen_once(replace(own, confirmed=nothing), [sure]))
