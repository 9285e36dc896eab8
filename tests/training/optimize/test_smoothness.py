"""The embedding smoothness's sample, as Gaussians come and go."""

from __future__ import annotations

import torch

from frog_blender.engine.recipes import RECIPES
from frog_blender.engine.training.optimize.neighbours import NeighbourGraph


def drawn(count: int) -> NeighbourGraph:
    means = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    found = NeighbourGraph.sample(means, RECIPES["draft"], torch.Generator().manual_seed(1))
    assert found is not None
    return found


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
    found = {
        int(who[anchor]): {(int(who[n]), float(w)) for n, w in zip(*row, strict=True) if w}
        for anchor, *row in zip(after.anchors, after.neighbours, after.weights, strict=True)
    }
    assert len(found) == 47 and found == expected
    embeddings = torch.randn(len(who), 4, requires_grad=True)
    embeddings.grad = torch.zeros_like(embeddings)
    after.add_gradient(embeddings, 0, 1.0)
    assert embeddings.grad.isfinite().all() and not embeddings.grad[-2:].any()


def test_nobody_is_left_of_a_sample() -> None:
    assert drawn(5).reindexed(torch.tensor([5, 6])) is None
