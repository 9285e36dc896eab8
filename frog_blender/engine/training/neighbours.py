"""Nearest neighbours among points, in torch on any device, in pieces that fit in memory."""

from __future__ import annotations

import torch

# Distances held at once: what stays in a processor's cache, and what keeps a GPU busy.
_CPU_PIECE, _GPU_PIECE = 400_000, 16_000_000


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
    columns = among.T.contiguous()
    distances, indices = [], []
    elements = _CPU_PIECE if points.device.type == "cpu" else _GPU_PIECE
    for piece in points.split(max(1, elements // max(1, len(among)))):
        # From differences: a matrix product would lose small distances far from the origin.
        square = points.new_zeros(len(piece), len(among))
        for own, other in zip(piece.T, columns, strict=True):
            difference = own[:, None] - other
            square.addcmul_(difference, difference)
        found = square.topk(wanted, largest=False)
        distances.append(found.values[:, extra:].sqrt())
        indices.append(found.indices[:, extra:])
    return torch.cat(distances), torch.cat(indices)


def spacings(points: torch.Tensor, among: torch.Tensor | None = None) -> torch.Tensor:
    """(P,) root mean square distance to the three nearest neighbours: the size of a fresh Gaussian."""
    own = among is None
    distances, _ = nearest(points, points if among is None else among, 3, skip_self=own)
    if distances.shape[1] == 0:
        return torch.full((len(points),), 0.01, device=points.device)
    return distances.square().mean(1).sqrt().clamp(min=1e-6)
