"""Splats that end at meshes: where the edge of an object crosses a pixel, as much of it as the object covers."""

import numpy as np
import pytest
from support.builders import odd_camera, plain_camera, random_gaussians

from frog_blender.engine.native.options import RasterizeOptions
from frog_blender.engine.playback.render import draw
from frog_blender.render import holdout
from frog_blender.render.holdout import draw_before, limits_of_mesh

WHOLE = RasterizeOptions()


def card(camera, left, right, depth):
    """A card before a camera: all rows, pixel columns from ``left`` to ``right``."""
    columns, rows = np.array([left, right, right, left]), np.array([-9.0, -9, 99, 99])
    rays = np.stack([columns, rows, np.ones(4)], 1) @ np.linalg.inv(camera.intrinsics).T
    points = np.c_[rays * depth, np.ones(4)] @ np.linalg.inv(camera.world_to_camera).T
    return points[:, :3], np.array([[0, 1, 2], [0, 2, 3]])


def together(*meshes):
    vertices = np.concatenate([points for points, _ in meshes])
    return vertices, np.concatenate([triangles + 4 * i for i, (_, triangles) in enumerate(meshes)])


@pytest.mark.parametrize("edge", [10.0, 10.24, 10.5, 10.9])
def test_an_edge_covers_its_share_of_a_pixel(edge):
    camera = odd_camera()
    limits = limits_of_mesh(*card(camera, -5, edge, 3.0), camera, WHOLE)
    covered = limits.share.copy()
    covered[np.isinf(limits.front)] = 0.0
    expected = np.clip(edge - np.arange(camera.width), 0, 1)
    assert np.abs(covered - expected).max() <= 0.5 / 4
    np.testing.assert_allclose(limits.front[covered > 0], 3.0, rtol=1e-5)
    assert np.isinf(limits.behind[covered < 1]).all()
    whole = limits.share == 1
    np.testing.assert_array_equal(limits.front[whole], limits.behind[whole])


def test_behind_an_edge_may_be_another_surface():
    camera = plain_camera()
    limits = limits_of_mesh(*together(card(camera, -5, 10.5, 2.0), card(camera, -5, 20.25, 5.0)), camera, WHOLE)
    assert (limits.share[:, 10] == 0.5).all() and (limits.share[:, 20] == 0.25).all()
    np.testing.assert_allclose(limits.front[:, [5, 10, 15, 20]], [[2, 2, 5, 5]] * camera.height, rtol=1e-5)
    np.testing.assert_allclose(limits.behind[:, [5, 10, 15]], [[2, 5, 5]] * camera.height, rtol=1e-5)
    assert np.isinf(limits.behind[:, 20]).all()


def test_of_three_surfaces_the_nearest_is_told_apart():
    camera = plain_camera()
    cards = card(camera, -5, 10.5, 2.0), card(camera, -5, 10.75, 50.0)
    limits = limits_of_mesh(*together(*cards), camera, WHOLE)
    assert (limits.share[:, 10] == 0.5).all()
    np.testing.assert_allclose(limits.front[:, 10], 2.0, rtol=1e-5)
    np.testing.assert_allclose(limits.behind[:, 10], 100.0, rtol=1e-5)  # between what is far and nothing


def test_a_slanted_surface_is_one():
    camera = plain_camera()
    points, triangles = card(camera, -40, 60, 3.0)
    points[1:3] *= 2.0  # further away on the right
    limits = limits_of_mesh(points, triangles, camera, WHOLE)
    assert (limits.share == 1).all() and np.isfinite(limits.front).all()


@pytest.mark.parametrize("region", [None, (5, 3, 31, 20)])
def test_an_image_is_mixed_of_both(region, monkeypatch):
    monkeypatch.setattr(holdout, "MOST_DEPTHS", 5000)  # several bands
    camera = odd_camera()
    gaussians, options = random_gaussians(camera, 60), RasterizeOptions(region=region)
    depths = np.sort(gaussians.means @ camera.rotation[2] + camera.world_to_camera[2, 3])
    mesh = card(camera, 11.5, 20.75, depths[20])
    limits = limits_of_mesh(*mesh, camera, options)
    drawing = draw_before(limits, gaussians, camera, options)
    before, open_ = (draw(gaussians, camera, options=options, depth_limit=limit) for limit in (limits.front, None))
    first = region[0] if region else 0
    shares = {11: 0.5, 12: 1.0, 19: 1.0, 20: 0.75, 21: 0.0}
    for column, share in shares.items():
        at = (slice(None), column - first)
        limited = draw(gaussians, camera, options=options, depth_limit=np.full_like(limits.front, depths[20]))
        for name in ("rgb", "alpha"):
            expected = share * getattr(limited, name)[at] + (1 - share) * getattr(open_, name)[at]
            np.testing.assert_allclose(getattr(drawing, name)[at], expected, atol=1e-4)
        chosen = limited if share >= 0.5 else open_
        np.testing.assert_array_equal(drawing.median_index[at], chosen.median_index[at])
    assert np.abs(before.alpha - open_.alpha).max() > 0.3, "the card hides something"
