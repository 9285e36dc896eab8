"""Nearest neighbours are exact wherever a capture puts its origin, and in whatever unit."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from helpers import run_python

from frog_blender.engine.training import neighbours
from frog_blender.engine.training.neighbours import nearest, spacings


@pytest.mark.parametrize(("unit", "offset"), [(1.0, 0.0), (1.0, 500.0), (1000.0, 0.0), (1e-3, 0.0)])
def test_neighbours_and_spacings_are_exact(unit: float, offset: float) -> None:
    grid = torch.stack(torch.meshgrid(*[torch.arange(7.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    points = 0.25 * unit * grid + offset
    distances, indices = nearest(points, points, 3, skip_self=True)
    assert torch.allclose(distances, torch.full_like(distances, 0.25 * unit), rtol=1e-3)
    assert not (indices == torch.arange(len(points))[:, None]).any()
    assert torch.allclose(spacings(points), torch.full((len(points),), 0.25 * unit), rtol=1e-3)


def test_pieces_that_do_not_divide_the_points_and_nobody_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    points, among = torch.rand(23, 3), torch.rand(40, 3)
    whole = nearest(points, among, 5, skip_self=False)
    assert torch.equal(torch.cdist(points.double(), among.double()).topk(5, largest=False).indices, whole[1])
    for elements in (1, 40 * 7, 40 * 23):
        monkeypatch.setattr(neighbours, "_CPU_PIECE", elements)
        for found, expected in zip(nearest(points, among, 5, skip_self=False), whole, strict=True):
            assert torch.equal(found, expected)
    distances, indices = nearest(points[:0], among, 5, skip_self=False)
    assert distances.shape == indices.shape == (0, 5)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not say how much memory was used")
def test_many_points_leave_no_holes_in_memory() -> None:
    """Results between buffers that came and went made the heap grow by gigabytes."""
    code = """
import torch
from frog_blender.engine.training.neighbours import nearest
def peak():
    return int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]) / 1024
points = torch.rand(12_000, 3)
nearest(points[:50], points, 3, skip_self=True)
before = peak()
nearest(points, points, 3, skip_self=True)
print(peak() - before)
"""
    run = run_python(code)
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) < 100, "megabytes"
