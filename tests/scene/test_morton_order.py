"""Neighbours in space become neighbours in memory."""

from __future__ import annotations

import numpy as np
import pytest
from support.builders import steps_between

from frog_blender.engine.scene.quantization import morton_order, morton_order_by_range


def test_neighbours_come_together() -> None:
    means = np.float32(np.random.default_rng(3).uniform(-1, 1, (4000, 3)))
    order = morton_order(means)
    assert sorted(order) == list(range(4000))
    assert steps_between(means[order]) < 0.2 * steps_between(means)


def test_one_far_away_leaves_the_others_in_order() -> None:
    means = np.float32(np.random.default_rng(3).uniform(-1, 1, (4000, 3)))
    means[17] = 1e6
    order = morton_order(means)
    assert steps_between(means[order[order != 17]]) < 0.2 * steps_between(means)


@pytest.mark.parametrize("moving", [0, 1, 30, 50])
def test_dynamic_ones_stay_before_static_ones(moving: int) -> None:
    means = np.float32(np.random.default_rng(4).normal(size=(50, 3)))
    order = morton_order_by_range(means, moving)
    assert sorted(order[:moving]) == list(range(moving))
    np.testing.assert_array_equal(order[:moving], morton_order(means[:moving]))
    np.testing.assert_array_equal(order[moving:], moving + morton_order(means[moving:]))


def test_no_gaussians() -> None:
    assert morton_order(np.empty((0, 3), np.float32)).shape == (0,)
