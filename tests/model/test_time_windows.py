"""Gaussians with a time of their own are seen around it, and the others as if there were none."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.frog import Frog, FrogSettings
from frog_blender.engine.model.interface import ScheduleState
from frog_blender.engine.model.time_windows import can_open, open_windows

COUNT, FRAMES = 40, 30
SETTINGS = FrogSettings(temporal_rows=FRAMES, coarse_rows=15, embedding_size=32, modulation=True)


def model_of(seed: int, settings: FrogSettings = SETTINGS) -> Frog:
    torch.manual_seed(seed)
    points, colors = torch.randn(COUNT, 3), torch.rand(COUNT, 3)
    return Frog(CanonicalField(new_gaussians(points, colors, torch.full((COUNT,), 0.1), 4, 32)), settings)


def opacities(model: Frog) -> torch.Tensor:
    """(FRAMES, COUNT) as they are drawn at the start."""
    with torch.no_grad():
        return torch.stack(
            [model.deform(f / (FRAMES - 1), ScheduleState(0.0, 0.0))[0].opacities for f in range(FRAMES)]
        )


@pytest.mark.parametrize("seed", range(4))
def test_a_gaussian_is_seen_around_its_own_time(seed: int) -> None:
    model = model_of(seed)
    frames = torch.arange(COUNT) % FRAMES
    open_windows(model, frames / (FRAMES - 1))
    seen = opacities(model)
    own = seen[frames, torch.arange(COUNT)]
    assert (own > 0.6).all()
    apart = (torch.arange(FRAMES)[:, None] - frames).abs()
    assert (seen[apart <= 1] > 0.2).all()
    assert seen[apart >= 6].mean() < 0.25
    assert (seen[apart >= 6] < 0.1).float().mean() > 0.6


def test_gaussians_without_a_time_and_all_else_are_as_before() -> None:
    plain, model = model_of(0), model_of(0)
    times = torch.full((COUNT,), torch.nan)
    times[30:] = torch.linspace(0, 1, 10)
    open_windows(model, times)
    assert torch.equal(opacities(plain)[:, :30], opacities(model)[:, :30])
    for time in (0.0, 0.4, 1.0):
        before, after = plain.deform(time)[0], model.deform(time)[0]
        for name in ("means", "quaternions", "scales", "sh"):
            assert torch.equal(getattr(before, name), getattr(after, name))


def test_windows_can_be_learned() -> None:
    model = model_of(0)
    open_windows(model, torch.linspace(0, 1, COUNT))
    model.deform(0.5)[0].opacities.sum().backward()
    assert model.canonical.embeddings.grad is not None and model.canonical.embeddings.grad.abs().sum() > 0
    assert model.temporal_table.grad is not None and model.temporal_table.grad.abs().sum() > 0


def test_nobody_with_a_time_changes_nothing() -> None:
    plain, model = model_of(0), model_of(0)
    open_windows(model, torch.full((COUNT,), torch.nan))
    assert all(torch.equal(a, b) for a, b in zip(plain.parameters(), model.parameters(), strict=True))


@pytest.mark.parametrize("change", [{"modulation": False}, {"deformed_opacity": False}, {"head_width": 16}])
def test_what_has_no_windows(change: dict[str, bool | int]) -> None:
    assert can_open(model_of(0)) and not can_open(model_of(0, replace(SETTINGS, **change)))
