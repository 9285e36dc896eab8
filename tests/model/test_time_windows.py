"""Gaussians with a time of their own are seen around it."""

from dataclasses import replace

import pytest
import torch

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.interface import ScheduleState
from frog_blender.engine.model.time_windows import COLUMNS, has_windows, keep_apart, open_windows

COUNT, FRAMES, SIZE = 40, 30, 32 + COLUMNS
SETTINGS = FrogSettings(temporal_rows=FRAMES, coarse_rows=15, embedding_size=SIZE, modulation=True)


def model_of(seed: int, settings: FrogSettings = SETTINGS) -> Frog:
    torch.manual_seed(seed)
    points, colors = torch.randn(COUNT, 3), torch.rand(COUNT, 3)
    return Frog(CanonicalField(new_gaussians(points, colors, torch.full((COUNT,), 0.1), 4, SIZE)), settings)


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


def test_learning_leaves_the_windows_apart() -> None:
    """Whatever is learned, Gaussians without a time are what the other units make of the other columns."""
    model = model_of(0)
    times = torch.full((COUNT,), torch.nan)
    times[30:] = torch.linspace(0, 1, 10)
    open_windows(model, times)
    assert has_windows(model) and not has_windows(model_of(0))
    assert not has_windows(model_of(0, replace(SETTINGS, modulation=False)))
    optimizer, field = torch.optim.Adam(model.parameters(), lr=0.02), model.deformation
    rise = float(field.output_weight.detach()[model.output_rows("opacity_logits"), 0])
    generator = torch.Generator().manual_seed(0)
    for step in range(20):
        optimizer.zero_grad()
        gaussians = model.deform(step / 19)[0]
        (
            gaussians.means.square().sum() + (gaussians.opacities * torch.rand(COUNT, generator=generator)).sum()
        ).backward()
        optimizer.step()
        keep_apart(model)
        assert has_windows(model)
    embeddings = model.canonical.embeddings.detach()
    assert not embeddings[:30, -COLUMNS:].any() and embeddings[:30].any()
    assert not field.embedding_weight[:, -COLUMNS:].any() and not field.modulation_weight[1:, -COLUMNS:].any()
    assert not field.modulation_weight[0, :-COLUMNS].any() and not field.temporal_weight[0].any()
    others = torch.ones(len(field.output_weight), dtype=torch.bool)
    others[model.output_rows("opacity_logits")] = False
    assert not field.output_weight[others, 0].any() and float(field.output_weight[~others, 0]) != rise
    hidden = field.hidden(model.temporal_embedding(0.3), embeddings)
    assert not hidden[:30, 0].any() and hidden[30:, 0].any()


def test_nobody_with_a_time_changes_nothing() -> None:
    plain, model = model_of(0), model_of(0)
    open_windows(model, torch.full((COUNT,), torch.nan))
    assert all(torch.equal(a, b) for a, b in zip(plain.parameters(), model.parameters(), strict=True))
