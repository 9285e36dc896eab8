"""The order in which a graphics card blends: the farthest first, as the rasterizer has it the other way round."""

from collections.abc import Callable

import numpy as np
import pytest

from frog_blender.engine.native.binding import depth_order

PLANE = (0.3, -0.2, 0.9, 1.5)


@pytest.mark.parametrize("count", [0, 1, 7, 8192, 40_000, 100_003])
def test_the_farthest_comes_first(count: int) -> None:
    points = np.random.default_rng(count).normal(0, 3, (count, 3)).astype(np.float32)
    order = depth_order(points, PLANE, 0.2)
    depths = points @ np.array(PLANE[:3], np.float32) + np.float32(PLANE[3])
    assert order.dtype == np.float32
    chosen = order.astype(int)
    assert np.array_equal(np.sort(chosen), np.flatnonzero(depths >= 0.2))
    assert (np.diff(depths[chosen].astype(np.float64)) <= 1e-5).all()


def test_far_and_near_are_told_apart_to_a_part_of_their_depth() -> None:
    random = np.random.default_rng(5)
    depths = np.exp(random.uniform(np.log(0.01), np.log(1e7), 300_000)).astype(np.float32)
    points = np.stack([np.zeros_like(depths), np.zeros_like(depths), depths], axis=1)
    shown = depths[depth_order(points, (0, 0, 1, 0), 0.01).astype(int)].astype(np.float64)
    assert (shown[1:] <= shown[:-1] * (1 + 2.0**-17)).all()


def test_equal_depths_keep_their_order_and_behind_the_camera_is_nothing() -> None:
    points = np.zeros((6, 3), np.float32)
    points[:, 2] = [1, 2, 1, -1, 2, np.nan]
    assert depth_order(points, (0, 0, 1, 0), 0.01).tolist() == [1, 4, 0, 2]
    assert depth_order(points, (0, 0, 1, 0), -5.0).tolist() == [1, 4, 0, 2, 3]


def test_it_does_not_depend_on_the_number_of_threads(same_on_threads: Callable[..., None]) -> None:
    points = np.random.default_rng(1).integers(0, 50, (70_000, 3)).astype(np.float32)
    same_on_threads(lambda: depth_order(points, PLANE, 0.0))


@pytest.mark.parametrize(
    "points", [np.zeros((3, 2), np.float32), np.zeros((3, 3)), np.zeros((4, 6), np.float32)[:, ::2]]
)
def test_other_arrays_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected contiguous float32"):
        depth_order(points, PLANE, 0.0)
