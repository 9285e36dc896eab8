"""The embedding smoothness (FRoG, section on optimisation)."""

from __future__ import annotations

import torch


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
