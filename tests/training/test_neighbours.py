"""Nearest neighbours are exact wherever a capture puts its origin, and in whatever unit."""

from __future__ import annotations

import pytest
import torch

from frog_blender.engine.training.neighbours import nearest, spacings


@pytest.mark.parametrize(("unit", "offset"), [(1.0, 0.0), (1.0, 500.0), (1000.0, 0.0), (1e-3, 0.0)])
def test_neighbours_and_spacings_are_exact(unit: float, offset: float) -> None:
    grid = torch.stack(torch.meshgrid(*[torch.arange(7.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    points = 0.25 * unit * grid + offset
    distances, indices = nearest(points, points, 3, skip_self=True)
    assert torch.allclose(distances, torch.full_like(distances, 0.25 * unit), rtol=1e-3)
    assert not (indices == torch.arange(len(points))[:, None]).any()
    assert torch.allclose(spacings(points), torch.full((len(points),), 0.25 * unit), rtol=1e-3)
