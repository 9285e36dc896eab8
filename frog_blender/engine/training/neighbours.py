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
    elements = _CPU_PIECE if points.device.type == "cpu" else _GPU_PIECE
    rows = max(1, min(len(points), elements // max(1, len(among))))
    # The same memory for every piece: asked for piece by piece, between results that stay, the heap grew by gigabytes.
    squares, differences = points.new_empty(2, rows, len(among))
    distances = points.new_empty(len(points), wanted)
    indices = torch.empty(len(points), wanted, dtype=torch.int64, device=points.device)
    for start in range(0, len(points), rows):
        piece = points[start : start + rows]
        square, difference = squares[: len(piece)].zero_(), differences[: len(piece)]
        # From differences: a matrix product would lose small distances far from the origin.
        for own, other in zip(piece.T, columns, strict=True):
            torch.sub(own[:, None], other, out=difference)
            square.addcmul_(difference, difference)
        found = distances[start : start + rows], indices[start : start + rows]
        torch.topk(square, wanted, largest=False, out=found)
    return distances[:, extra:].sqrt(), indices[:, extra:].contiguous()


def spacings(points: torch.Tensor, among: torch.Tensor | None = None) -> torch.Tensor:
    """(P,) root mean square distance to the three nearest neighbours: the size of a fresh Gaussian."""
    own = among is None
    distances, _ = nearest(points, points if among is None else among, 3, skip_self=own)
    if distances.shape[1] == 0:
        return torch.full((len(points),), 0.01, device=points.device)
    return distances.square().mean(1).sqrt().clamp(min=1e-6)
