"""The filmed scene opened, and trainers on it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import synthetic_capture as film
from support.image_stores import ImageStore
from support.training_steps import train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import Recipe, recipe
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.optimize.trainer import Trainer, TrainerFactory
from frog_blender.engine.training.session.checkpoint import State, restore, state_of
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import add_hooks

# Rates at which six hundred steps are enough to follow the ball (four hundred are not, with most seeds).
LIVELY = {"steps_per_moment": 0, "network_rate": 1e-3, "embedding_rate": 3e-2, "mean_rate": 2e-4, "max_gaussians": 600}


class WatchedStore(ImageStore):
    """A frame store that remembers which images were read."""

    def __init__(self, store: FrameStore) -> None:
        self._store = store
        self.read: list[int] = []

    def image(self, shot_index: int) -> np.ndarray:
        self.read.append(shot_index)
        return self._store.image(shot_index)


@pytest.fixture(scope="session")
def lively() -> Callable[..., Recipe]:
    return lambda steps, **changes: recipe("draft", steps=steps, **{**LIVELY, **changes})


@pytest.fixture(scope="session")
def make_trainer(capture: Capture, store: FrameStore, lively: Callable[..., Recipe]) -> Callable[..., Trainer]:
    """``make(steps, method="frog", **options)``: options of ``make`` below, and changes of the recipe."""

    def make(
        steps: int,
        method: str = "frog",
        *,
        seed: int = 0,
        watched: Any = None,
        compression: CompressionSettings | None = None,
        trainer_type: TrainerFactory = Trainer,
        seeds: int = 300,
        **changes: Any,
    ) -> Trainer:
        settings, frames = lively(steps, **changes), watched or store
        trainer = trainer_type(capture, frames, film.seeds(seeds), settings, JobOptions(method=method, seed=seed))
        add_hooks(trainer, compression or CompressionSettings())
        return trainer

    return make


@pytest.fixture(scope="session")
def halfway(make_trainer: Callable[..., Trainer]) -> Callable[..., Trainer]:
    """``halfway(compression=None, **recipe changes)``: 90 of 120 steps with automatic capacity, before Gaussians are
    pruned; all are dynamic. The steps are taken once for the same changes."""
    states: dict[str, State] = {}

    def make(compression: CompressionSettings | None = None, **changes: Any) -> Trainer:
        trainer = make_trainer(120, capacity="auto", compression=compression, **changes)
        key = repr(sorted((name, value) for name, value in changes.items() if name != "dynamic_share"))
        if key in states:
            restore(trainer, states[key])
        else:
            states[key] = state_of(train(trainer, until=90))
        return trainer

    return make


@pytest.fixture
def watched(store: FrameStore) -> WatchedStore:
    return WatchedStore(store)


@pytest.fixture
def make_job(
    filmed: Path, tmp_path: Path, lively: Callable[..., Recipe], own_cache: Path
) -> Callable[..., TrainingJob]:
    """``make(steps, job=None, **recipe changes)``: from known seed points to ``x.frog``, but for what ``job`` says."""

    def make(steps: int, job: dict[str, Any] | None = None, **changes: Any) -> TrainingJob:
        usual = {"seed": 2, "seeds": film.seeds(), "device": "cpu", "recipe": lively(steps, **changes)}
        return TrainingJob(**{"capture": filmed, "output": tmp_path / "x.frog", **usual, **(job or {})})

    return make
