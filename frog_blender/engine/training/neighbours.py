"""Nearest neighbours among points, in torch on any device, in pieces that fit in memory."""

from __future__ import annotations

import torch

_PIECE_ELEMENTS = 16_000_000  # distances held at once


def nearest(
    points: torch.Tensor, among: torch.Tensor, count: int, skip_self: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """Distances (P, count) ascending, and indices (P, count) into ``among``.

    Args:
        points: (P, 3).
        among: (M, 3) with M > count.
        count: neighbours wanted; fewer come back when there are fewer.
        skip_self: leave out the nearest, which is the point itself.
    """
    extra = int(skip_self)
    wanted = min(count + extra, len(among))
    distances, indices = [], []
    for piece in points.split(max(1, _PIECE_ELEMENTS // max(1, len(among)))):
        # Exact distances: the faster way through a matrix product loses them far from the origin.
        distance = torch.cdist(piece, among, compute_mode="donot_use_mm_for_euclid_dist")
        found = distance.topk(wanted, largest=False)
        distances.append(found.values[:, extra:])
        indices.append(found.indices[:, extra:])
    return torch.cat(distances), torch.cat(indices)


def spacings(points: torch.Tensor, among: torch.Tensor | None = None) -> torch.Tensor:
    """(P,) root mean square distance to the three nearest neighbours: the size of a fresh Gaussian."""
    own = among is None
    distances, _ = nearest(points, points if among is None else among, 3, skip_self=own)
    if distances.shape[1] == 0:
        return torch.full((len(points),), 0.01, device=points.device)
    return distances.square().mean(1).sqrt().clamp(min=1e-6)
