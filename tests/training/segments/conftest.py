"""A film of twenty frames, and small trainings of it in two segments."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import synthetic_capture as film

from frog_blender.engine.training.recipe import recipe
from frog_blender.engine.training.segments.plan import SegmentPlan
from frog_blender.engine.training.segments.stages import Stages
from frog_blender.engine.training.session.job import TrainingJob

SETTINGS = {"steps_per_moment": 0, "max_gaussians": 400, "capacity": "auto"}


@pytest.fixture(scope="session")
def long_film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    there_and_back = [abs(5 - frame % 10) for frame in range(20)]
    return film.write_capture(tmp_path_factory.mktemp("long") / "capture", there_and_back)


@pytest.fixture
def stages(long_film: Path, quick_seeds: None, tmp_path: Path) -> Callable[..., Stages]:
    """``stages(name="take", **fields of the job)``: of 60 steps each."""

    def make(name: str = "take", **changes: Any) -> Stages:
        settings = recipe("draft", steps=60, **SETTINGS)
        given = {"recipe": settings, "lossless": True, "overwrite": False, "event_seconds": 0.0, "device": "cpu"}
        return Stages(SegmentPlan.begin(TrainingJob(long_film, tmp_path / f"{name}.frog", **{**given, **changes}), 10))

    return make
