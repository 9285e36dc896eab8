"""From the rasterizer's drawing to the pixels of passes."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from frog_blender.color_spaces import image_to_linear, to_display, to_linear
from frog_blender.render.passes import NO_SURFACE, combined_pass, depth_pass, pass_pixels

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
