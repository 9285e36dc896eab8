"""Nearest neighbours are exact wherever a capture puts its origin; their sample follows Gaussians that come and go."""

import pytest
import torch

from frog_blender.engine.recipes import RECIPES
from frog_blender.engine.training.optimize.neighbours import (
    SMOOTHED_EVERY,
    NeighbourGraph,
    by_distances,
    nearest,
    neighbour_weights,
    spacings,
)


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
    for array in nearest(points[:0], points, 5, skip_self=False):
        assert array.shape == (0, 3)
    for array in nearest(points, points, 5, skip_self=True):
        assert array.shape == (3, 2)
    for array in nearest(points[:1], points[:1], 5, skip_self=True):
        assert array.shape == (1, 0)
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


def drawn(count: int) -> NeighbourGraph:
    means = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    sample = NeighbourGraph.sample(means, RECIPES["draft"], torch.Generator().manual_seed(1))
    assert sample is not None
    return sample


def test_a_sample_follows_its_gaussians_to_other_places() -> None:
    before, gone = drawn(50), [3, 4, 41]
    kept = [i for i in range(50) if i not in gone]
    who = torch.tensor([*kept, 50, 51])  # the last two are new
    after = before.reindexed(who)
    assert after is not None
    expected = {
        int(anchor): {(int(n), float(w)) for n, w in zip(*row, strict=True) if int(n) not in gone}
        for anchor, *row in zip(before.anchors, before.neighbours, before.weights, strict=True)
        if int(anchor) not in gone
    }
    pairs = {
        int(who[anchor]): {(int(who[n]), float(w)) for n, w in zip(*row, strict=True) if w}
        for anchor, *row in zip(after.anchors, after.neighbours, after.weights, strict=True)
    }
    assert len(pairs) == 47 and pairs == expected
    embeddings = torch.randn(len(who), 4, requires_grad=True)
    embeddings.grad = torch.zeros_like(embeddings)
    after.add_gradient(embeddings, 0, 1.0)
    assert embeddings.grad.isfinite().all() and not embeddings.grad[-2:].any()


def test_nobody_is_left_of_a_sample() -> None:
    assert drawn(5).reindexed(torch.tensor([5, 6])) is None


def cloud(kind: str, scale: float) -> torch.Tensor:
    generator = torch.Generator().manual_seed(4)
    if kind == "volume":
        return torch.randn(1500, 3, generator=generator) * scale
    surface = torch.randn(1500, 3, generator=generator)
    surface[:, 2] = 0.01 * surface[:, 2] + (surface[:, 0] * 3).sin()
    return surface * scale


@pytest.mark.parametrize("name", ["draft", "standard", "paper-exact"])
@pytest.mark.parametrize("kind", ["volume", "surface"])
def test_smoothness_weights_are_the_same_in_any_unit_and_never_all_near_zero_or_one(name: str, kind: str) -> None:
    recipe = RECIPES[name]
    by_unit = []
    for scale in (1e-3, 1.0, 1e3):
        points = cloud(kind, scale)
        distances, _ = nearest(points[:300], points, recipe.smoothness_neighbours, skip_self=True)
        weights = neighbour_weights(distances, recipe.smoothness_falloff)
        assert weights.shape == (300, recipe.smoothness_neighbours)
        between = ((weights > 0.05) & (weights < 0.95)).float().mean()
        assert float(between) > 0.3, f"{float((weights <= 0.05).float().mean()):.2f} of the weights are near 0"
        by_unit.append(weights)
    torch.testing.assert_close(by_unit[0], by_unit[1], atol=2e-3, rtol=0)
    torch.testing.assert_close(by_unit[2], by_unit[1], atol=2e-3, rtol=0)


def test_smoothness_gradient_is_that_of_the_weighted_distance() -> None:
    torch.manual_seed(0)
    embeddings = torch.randn(6, 3, dtype=torch.float64, requires_grad=True)
    anchors, neighbours = torch.tensor([0, 2]), torch.tensor([[1, 2], [0, 3]])
    weights = torch.tensor([[1.0, 0.5], [0.2, 0.0]], dtype=torch.float64)
    distances = (embeddings[anchors][:, None] - embeddings[neighbours]).norm(dim=2)
    (expected,) = torch.autograd.grad(0.7 * SMOOTHED_EVERY * (weights * distances).mean(), embeddings)
    embeddings.grad = torch.ones_like(embeddings)
    NeighbourGraph(anchors, neighbours, weights).add_gradient(embeddings, 0, 0.7)
    torch.testing.assert_close(embeddings.grad - 1, expected)
    assert not expected[3:].any()


def test_smoothness_of_equal_embeddings_has_no_gradient_and_no_nan() -> None:
    embeddings = torch.ones(3, 2, requires_grad=True)
    embeddings.grad = torch.zeros(3, 2)
    NeighbourGraph(torch.tensor([0]), torch.tensor([[1, 2]]), torch.ones(1, 2)).add_gradient(embeddings, 0, 1.0)
    assert not embeddings.grad.any()
