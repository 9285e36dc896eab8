"""What a training begins with: seed points with a time are seen around it, where the method can do that."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from support import synthetic_capture

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.seeds import Seeds
from frog_blender.engine.model.interface import SceneModel
from frog_blender.engine.recipes import RECIPES, Recipe, recipe
from frog_blender.engine.registry import METHODS
from frog_blender.engine.training.optimize.initialization import first_model

LAST = synthetic_capture.FRAMES - 1


def timed_seeds() -> Seeds:
    """Of 300 points, the last twenty are there at the last frame."""
    frames = np.full(300, np.nan, np.float32)
    frames[280:] = LAST
    return replace(synthetic_capture.seeds(), frames=frames)


def begun(capture: Capture, seeds: Seeds, method: str = "frog", **settings: bool) -> SceneModel:
    torch.manual_seed(0)
    chosen = METHODS[method].adapted(recipe("draft", **{"moment_seeds": True} | settings))
    return first_model(capture, seeds, chosen, method, 4.0, torch.device("cpu"))


def test_points_with_a_time_are_seen_at_that_time_alone(capture: Capture) -> None:
    model, plain = begun(capture, timed_seeds()), begun(capture, synthetic_capture.seeds())
    with torch.no_grad():
        first, last = (model.deform(time)[0].opacities for time in (0.0, 1.0))
        usual = plain.deform(1.0)[0].opacities
    assert (last[280:] > 0.6).all() and (first[280:] < 0.2).all()
    assert torch.equal(first[:280], usual[:280]) and torch.equal(last[:280], usual[:280])


@pytest.mark.parametrize("method", METHODS)
def test_every_method_begins_with_them(capture: Capture, method: str) -> None:
    model = begun(capture, timed_seeds(), method)
    opened = bool((model.canonical.opacity_logits[280:] < model.canonical.opacity_logits[0] - 0.5).all())
    assert opened == (method == "frog")


def test_who_has_points_at_how_many_times() -> None:
    chosen = recipe("draft", moment_seeds=True)
    assert chosen.moments_for(30, 330) == 8  # of 15 coarse rows
    assert chosen.moments_for(300, 6000) == 15
    assert chosen.moments_for(2, 40) >= 2
    none: list[dict[str, Any]] = [
        {"moment_seeds": False},
        {"modulation": False},
        {"deformed_opacity": False},
        {"fusion": "dual"},
        {"head_width": 64},
        {"temporal_size": 32},
    ]
    assert not any(replace(chosen, **change).moments_for(30, 330) for change in none)
    for method in METHODS:
        adapted = METHODS[method].adapted(Recipe(moment_seeds=True))
        assert bool(adapted.moments_for(30, 330)) == (method == "frog")
    assert {name for name, each in RECIPES.items() if each.moments_for(30, 330)} == {"draft", "standard"}
