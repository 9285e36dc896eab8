"""Fresh Gaussians, and the embedding smoothness that must not depend on the capture's units."""

from __future__ import annotations

import pytest
import torch
from support.builders import plain_camera

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.rasterizer import rasterize
from frog_blender.engine.recipes import RECIPES
from frog_blender.engine.training.optimize.neighbours import (
    SMOOTHED_EVERY,
    NeighbourGraph,
    nearest,
    neighbour_weights,
)


def test_fresh_gaussians_are_what_they_were_made_from() -> None:
    points, colors = torch.randn(6, 3), torch.rand(6, 3)
    spacing = torch.rand(6) + 0.1
    field = CanonicalField(new_gaussians(points, colors, spacing, 9, 4))
    gaussians = field.gaussians()
    assert len(field) == 6 and gaussians.sh.shape == (6, 9, 3) and field.embeddings.shape == (6, 4)
    torch.testing.assert_close(gaussians.means, points)
    torch.testing.assert_close(gaussians.scales, spacing[:, None].expand(6, 3))
    torch.testing.assert_close(gaussians.opacities, torch.full((6,), 0.1))
    torch.testing.assert_close(gaussians.sh[:, 0] * 0.28209479177387814 + 0.5, colors)
    assert not gaussians.sh[:, 1:].any() and not field.embeddings.any()
    assert gaussians.quaternions.tolist() == [[1, 0, 0, 0]] * 6


def test_a_spacing_of_zero_is_survived() -> None:
    field = CanonicalField(new_gaussians(torch.zeros(2, 3), torch.zeros(2, 3), torch.zeros(2), 1, 0))
    assert torch.isfinite(field.log_scales).all()


def cloud(kind: str, scale: float) -> torch.Tensor:
    generator = torch.Generator().manual_seed(4)
    if kind == "volume":
        return torch.randn(1500, 3, generator=generator) * scale
    surface = torch.randn(1500, 3, generator=generator)
    surface[:, 2] = 0.01 * surface[:, 2] + (surface[:, 0] * 3).sin()
    return surface * scale


@pytest.mark.parametrize("name", ["draft", "standard", "paper"])
@pytest.mark.parametrize("kind", ["volume", "surface"])
def test_smoothness_weights_are_the_same_in_any_unit_and_never_all_near_zero_or_one(name: str, kind: str) -> None:
    recipe = RECIPES[name]
    found = []
    for scale in (1e-3, 1.0, 1e3):
        points = cloud(kind, scale)
        distances, _ = nearest(points[:300], points, recipe.smoothness_neighbours, skip_self=True)
        weights = neighbour_weights(distances, recipe.smoothness_falloff)
        assert weights.shape == (300, recipe.smoothness_neighbours)
        between = ((weights > 0.05) & (weights < 0.95)).float().mean()
        assert float(between) > 0.3, f"{float((weights <= 0.05).float().mean()):.2f} of the weights are near 0"
        found.append(weights)
    torch.testing.assert_close(found[0], found[1], atol=2e-3, rtol=0)
    torch.testing.assert_close(found[2], found[1], atol=2e-3, rtol=0)


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


def test_black_seeds_learn_colours() -> None:
    """A colour that is clipped at 0 gets no gradient; a seed's must not be."""
    camera = plain_camera()
    attributes = new_gaussians(torch.tensor([[0.0, 0, 2]]), torch.tensor([[0.9, 0.0, 1.0]]), torch.ones(1), 4, 8)
    field = CanonicalField(attributes)
    rasterize(field.gaussians(4), camera).rgb.sum().backward()
    assert field.sh.grad is not None and (field.sh.grad[0, 0] > 0).all()
