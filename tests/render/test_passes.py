"""From the rasterizer's drawing to the pixels of passes, and splats that end at meshes."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.builders import odd_camera, plain_camera, random_gaussians

from frog_blender.color_spaces import to_display
from frog_blender.engine.native.options import RasterizeOptions
from frog_blender.engine.playback.passes import NO_SURFACE, combined_pass, depth_pass
from frog_blender.engine.playback.render import draw
from frog_blender.engine.srgb import image_to_linear, to_linear
from frog_blender.render import holdout
from frog_blender.render.holdout import draw_before, limits_of_mesh
from frog_blender.render.passes import pass_pixels

SIZES = pytest.mark.parametrize("size", [(1, 1), (5, 31), (40, 32), (7, 33), (23, 100)])  # around a band's rows


def drawing_of(width: int, height: int) -> Any:
    random = np.random.default_rng(width * height)
    alpha = random.uniform(-0.001, 1.001, (height, width)).astype(np.float32)
    rgb = (random.uniform(0, 1, (height, width, 3)) * alpha[..., None].clip(0, 1)).astype(np.float32)
    median_z = random.uniform(0.5, 9, (height, width)).astype(np.float32)
    median_z[random.random((height, width)) < 0.3] = np.nan
    return SimpleNamespace(rgb=rgb, alpha=alpha, median_z=median_z)


@SIZES
@pytest.mark.parametrize("background", [(0.2, 0.7, 0.0), (0.5, 3.0, 0.1)])  # the second brighter than any image
def test_opaque_colour_is_over_the_background_as_displayed(size: tuple[int, int], background: tuple) -> None:
    drawing, behind = drawing_of(*size), np.array(background, np.float32)
    over = drawing.rgb + (1 - drawing.alpha.clip(0, 1)[..., None]) * behind
    combined = combined_pass(drawing, behind, *size)
    np.testing.assert_allclose(combined[..., :3], to_linear(over.clip(0, behind.max().clip(1))), atol=3e-5)
    assert (combined[..., 3] == 1).all()


@SIZES
def test_transparent_colour_is_premultiplied_light(size: tuple[int, int]) -> None:
    drawing = drawing_of(*size)
    combined, alpha = combined_pass(drawing, None, *size), drawing.alpha.clip(0, 1)[..., None]
    straight = (drawing.rgb / np.maximum(alpha, 1e-6)).clip(0, 1)
    np.testing.assert_allclose(combined[..., :3], to_linear(straight) * alpha, atol=3e-5)
    np.testing.assert_array_equal(combined[..., 3:], alpha)


@SIZES
def test_depth_is_the_surfaces_or_none(size: tuple[int, int]) -> None:
    drawing = drawing_of(*size)
    depth, there = depth_pass(drawing, *size, added=0.25), np.isfinite(drawing.median_z)
    np.testing.assert_array_equal(depth[there], drawing.median_z[there] - np.float32(0.25))
    assert (depth[~there] == np.float32(NO_SURFACE)).all()


def test_without_a_drawing_there_is_the_background_or_nothing() -> None:
    behind = np.array((0.5, 0.25, 1.0), np.float32)
    combined = combined_pass(None, behind, 3, 2)
    np.testing.assert_array_equal(combined[..., :3], np.broadcast_to(to_linear(behind), (2, 3, 3)))
    assert (combined[..., 3] == 1).all() and not combined_pass(None, None, 3, 2).any()
    assert (depth_pass(None, 3, 2) == np.float32(NO_SURFACE)).all()


def test_blender_takes_rows_from_the_bottom_without_a_copy() -> None:
    size = (6, 70)
    for values in (combined_pass(drawing_of(*size), None, *size), depth_pass(drawing_of(*size), *size)):
        pixels = pass_pixels(values)
        np.testing.assert_array_equal(pixels.reshape(values.shape), values[::-1])
        assert np.shares_memory(pixels, values)
    whole_numbers = np.arange(12, dtype=np.int32).reshape(3, 4)
    np.testing.assert_array_equal(pass_pixels(whole_numbers), [8, 9, 10, 11, 4, 5, 6, 7, 0, 1, 2, 3])


def test_colours_come_back_and_the_table_for_images_is_as_exact_as_it_says() -> None:
    values = np.linspace(0, 1.5, 1000, dtype=np.float32)
    np.testing.assert_allclose(to_display(to_linear(values)), values, atol=1e-5)
    linear = image_to_linear(values / 1.5)
    np.testing.assert_allclose(linear, to_linear(values / 1.5), atol=2e-5)
    assert linear.dtype == np.float32 and (linear[0], linear[-1]) == (0.0, 1.0)


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
