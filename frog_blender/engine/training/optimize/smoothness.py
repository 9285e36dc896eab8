"""The embedding smoothness (FRoG, section on optimisation): neighbours that move have embeddings alike."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..recipe import Recipe
from .nearest_neighbours import nearest

SMOOTHED_EVERY = 4  # steps between two that regularise, each for as many; their dozens of small operations cost time
_BATCH = 64  # anchors that such a step looks at


@dataclass(frozen=True)
class NeighbourGraph:
    """A sample of the Gaussians that move: anchors (A,), neighbours (A, k), weights (A, k)."""

    anchors: torch.Tensor
    neighbours: torch.Tensor
    weights: torch.Tensor

    @classmethod
    @torch.no_grad()
    def drawn(cls, means: torch.Tensor, recipe: Recipe, generator: torch.Generator) -> NeighbourGraph | None:
        """A new sample among ``means`` (M, 3); None where nobody has a neighbour."""
        if len(means) < 2:
            return None
        chosen = torch.randperm(len(means), generator=generator)[: recipe.smoothness_sample].to(means.device)
        distances, neighbours = nearest(means[chosen], means, recipe.smoothness_neighbours, skip_self=True)
        return cls(chosen, neighbours, neighbour_weights(distances, recipe.smoothness_falloff))

    def arranged(self, who: torch.Tensor) -> NeighbourGraph | None:
        """The same sample where others have come and some have gone, who are nobody's neighbours any more; None without
        anchors.

        Args:
            who: (M',) for each place an old index, or a larger one for who is new.
        """
        last = int(max(who.max(), self.neighbours.max(), self.anchors.max()))
        places = torch.full((last + 1,), -1, device=who.device)
        places[who] = torch.arange(len(who), device=who.device)
        left = places[self.anchors] >= 0
        neighbours = places[self.neighbours[left]]
        weights = torch.where(neighbours >= 0, self.weights[left], 0.0)
        return (
            NeighbourGraph(places[self.anchors[left]], neighbours.clamp(min=0), weights) if bool(left.any()) else None
        )

    def add_gradient(self, embeddings: torch.Tensor, step: int, weight: float) -> None:
        """Regularises ``embeddings`` (M, E) for SMOOTHED_EVERY steps at once; another part of the sample each time."""
        start = (step // SMOOTHED_EVERY * _BATCH) % max(1, len(self.anchors))
        part = slice(start, start + _BATCH)
        sample = self.anchors[part], self.neighbours[part], self.weights[part]
        add_embedding_smoothness(embeddings, *sample, SMOOTHED_EVERY * weight)


@torch.no_grad()
def add_embedding_smoothness(
    embeddings: torch.Tensor, anchors: torch.Tensor, neighbours: torch.Tensor, weights: torch.Tensor, weight: float
) -> None:
    """Adds to ``embeddings.grad`` the gradient of the mean over (i, j) of w_ij |e_i - e_j| (the paper's L_emb-reg).

    Written out, because only the few drawn rows have a gradient; automatic differentiation would make one of all rows
    for each of the two look-ups.

    Args:
        embeddings: (N, E) with a gradient.
        anchors: (A,) indices i, drawn this time.
        neighbours: (A, k) indices j.
        weights: (A, k), see ``neighbour_weights``.
        weight: of the loss.
    """
    assert embeddings.grad is not None
    differences = embeddings[anchors][:, None] - embeddings[neighbours]
    lengths = (differences.square().sum(-1) + 1e-12).sqrt()
    gradient = differences * (weight / weights.numel() * weights / lengths)[..., None]
    embeddings.grad.index_add_(0, anchors, gradient.sum(1))
    embeddings.grad.index_add_(0, neighbours.flatten(), gradient.flatten(0, 1), alpha=-1)


def neighbour_weights(distances: torch.Tensor, falloff: float) -> torch.Tensor:
    """exp(-falloff d^2) with d in units of the median nearest-neighbour distance, which makes it free of scene units.

    Args:
        distances: (A, k) ascending along k, world units.
    """
    unit = distances[:, 0].median().clamp(min=1e-12)
    return torch.exp(-falloff * (distances / unit).square())
