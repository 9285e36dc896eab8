"""Budgets of Gaussians and of bytes hold exactly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from frog_blender.engine.inference.scene import PlayableScene
from frog_blender.engine.training.job import TrainingJob, run_training
from frog_blender.engine.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("seeds_at_no_cost")
Make = Callable[..., Trainer]


def trained(trainer: Trainer) -> Trainer:
    while not trainer.finished:
        trainer.step()
    return trainer


@pytest.mark.parametrize("capacity", ["auto", "fixed"])
def test_a_budget_of_gaussians_is_never_exceeded(make_trainer: Make, capacity: str) -> None:
    trainer, most = make_trainer(60, capacity=capacity, max_gaussians=320), 0
    while not trainer.finished:
        trainer.step()
        most = max(most, trainer.count)
    assert 300 < most <= 320


def test_not_even_by_the_seeds(filmed: Path, tmp_path: Path, lively: Callable) -> None:
    task = TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(20, max_gaussians=150))
    assert list(run_training(task))[-1].gaussians <= 150


def test_a_budget_of_bytes_holds_exactly(filmed: Path, tmp_path: Path, lively: Callable) -> None:
    sizes, counts = {}, {}
    for name, most in (("a", None), ("b", 44_000), ("c", 41_000), ("again", 41_000)):
        path = tmp_path / f"{name}.frog"
        finished = list(run_training(TrainingJob(filmed, path, recipe=lively(60, capacity="auto"), max_bytes=most)))[-1]
        sizes[name], counts[name] = path.stat().st_size, PlayableScene.load(path).count
        assert counts[name] == finished.capacity["gaussians"] == finished.gaussians
    assert sizes["a"] > 43_000 and 39_000 < sizes["b"] <= 44_000 and 36_000 < sizes["c"] <= 41_000
    assert counts["a"] > counts["b"] > counts["c"] == counts["again"]
