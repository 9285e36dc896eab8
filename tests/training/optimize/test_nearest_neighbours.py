"""Nearest neighbours are exact wherever a capture puts its origin, and in whatever unit."""

from __future__ import annotations

import pytest
import torch

from frog_blender.engine.training.optimize.neighbours import by_distances, nearest, spacings


@pytest.mark.parametrize(("unit", "offset"), [(1.0, 0.0), (1.0, 500.0), (1000.0, 0.0), (1e-3, 0.0)])
def test_neighbours_and_spacings_are_exact(unit: float, offset: float) -> None:
    grid = torch.stack(torch.meshgrid(*[torch.arange(7.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    points = 0.25 * unit * grid + offset
    distances, indices = nearest(points, points, 3, skip_self=True)
    assert torch.allclose(distances, torch.full_like(distances, 0.25 * unit), rtol=1e-3)
    assert not (indices == torch.arange(len(points))[:, None]).any()
    assert torch.allclose(spacings(points), torch.full((len(points),), 0.25 * unit), rtol=1e-3)


def test_the_gpus_search_finds_what_the_tree_finds() -> None:
    points, among = torch.rand(23, 3), torch.rand(400, 3)
    distances, indices = nearest(points, among, 5, skip_self=False)
    expected = torch.cdist(points.double(), among.double()).topk(5, largest=False)
    assert torch.equal(indices, expected.indices)
    assert torch.allclose(distances.double(), expected.values, rtol=1e-5)
    for elements in (1, 400 * 7, 400 * 23):  # pieces that do not divide the points, too
        squares, others = by_distances(points, among, 5, piece_size=elements)
        assert torch.equal(others, indices)
        assert torch.allclose(squares.sqrt(), distances, rtol=1e-5)


def test_nobody_at_all_and_fewer_than_asked_for() -> None:
    points = torch.rand(3, 3)
    for found in nearest(points[:0], points, 5, skip_self=False):
        assert found.shape == (0, 3)
    for found in nearest(points, points, 5, skip_self=True):
        assert found.shape == (3, 2)
    for found in nearest(points[:1], points[:1], 5, skip_self=True):
        assert found.shape == (1, 0)
    assert float(spacings(points[:1])) > 0


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e30])
def test_points_that_are_nowhere_have_neighbours_that_exist(value: float) -> None:
    points = torch.rand(300, 3)
    points[7, 1] = points[9] = value
    distances, indices = nearest(points, points, 4, skip_self=True)
    assert bool(((indices >= 0) & (indices < 300)).all())
    usual = torch.ones(300, dtype=torch.bool)
    usual[[7, 9]] = False
    assert bool(torch.isfinite(distances[usual]).all())
    assert not bool(((indices == 7) | (indices == 9))[usual].any())
