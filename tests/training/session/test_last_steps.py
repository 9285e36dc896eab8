"""What a training does besides learning, and may leave undone: whatever fails there, what was learned plays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.training_steps import train

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.compression import schedule
from frog_blender.engine.training.compression.context import Compression
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events, export, loop
from frog_blender.engine.training.session.export import Metrics, build_scene
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.session import Session

STEPS = 20
MORE_THAN_ONCE = ("evaluate", "freeze_motion", "mean_dynamic_state")
ERRORS = [
    RuntimeError("torch does not like this"),
    np.linalg.LinAlgError("singular matrix"),
    ValueError("cannot convert float NaN to integer\nand more"),
    MemoryError(),
]
AT_THE_END = [
    *((schedule, name) for name in ("prune_unmissed", "freeze_motion")),
    (Compression, "mean_dynamic_state"),
    *((export, name) for name in ("reorder_for_playback", "playback_steps")),
    *((loop, name) for name in ("fit_budget", "draw_report_image")),
    (Trainer, "evaluate"),
]
ON_THE_WAY = [(schedule, name) for name in ("freeze_static_regions", "prune")]


def name_of(value: Any) -> str | None:
    return value[1] if isinstance(value, tuple) else None


@pytest.fixture
def task(filmed: Path, tmp_path: Path, lively: Callable, quick_seeds: None) -> TrainingJob:
    settings = lively(STEPS, capacity="auto")
    return TrainingJob(filmed, tmp_path / "x.frog", recipe=settings, seed=2, device="cpu")


def broken(monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception) -> None:
    """Lets ``what`` fail; what is done in the middle of a training as well, only at its end."""
    owner, name = what
    real = getattr(owner, name)

    def fails(*arguments: Any, **options: Any) -> Any:
        first = arguments[0]
        training = first.training if isinstance(first, Compression) else first
        if name in MORE_THAN_ONCE and not training.finished:
            return real(*arguments, **options)
        raise error

    monkeypatch.setattr(owner, name, fails)


def plays(task: TrainingJob) -> ScenePlayer:
    """The scene that lies where the job wants it, played at some times."""
    scene = ScenePlayer.load(task.output)
    for time in (0.0, 0.4, 1.0):
        assert all(np.isfinite(values).all() for values in vars(scene.at(time)).values())
    return scene


@pytest.mark.parametrize(("number", "what"), list(enumerate([*AT_THE_END, *ON_THE_WAY])), ids=name_of)
def test_a_pass_that_fails_costs_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, number: int, what: tuple[Any, str]
) -> None:
    errors = ERRORS if what in AT_THE_END else ERRORS[:3]  # memory that ends in the middle costs Gaussians
    broken(monkeypatch, what, errors[number % len(errors)])
    stream = list(run_training(task))
    said = [event.message for event in stream if isinstance(event, events.WarningEvent)]
    assert isinstance(stream[-1], events.Finished) and plays(task).header.steps == STEPS
    assert (stream[-1].psnr is None) == (what[1] == "evaluate") == ("psnr" not in plays(task).header.metrics)
    assert len(said) == 1 and said[0].endswith(".") and "\n" not in said[0]
    assert [event.step for event in stream if isinstance(event, events.Evaluated)][-1:] in ([STEPS], [18])


def test_what_a_failed_milestone_did_is_undone(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """It fails after half of the Gaussians were pruned."""
    before: dict[str, torch.Tensor] = {}

    class Watched(Trainer):
        def before_milestone(self) -> None:
            super().before_milestone()
            before.update({name: value.clone() for name, value in self.model.state_dict().items()})

    def fails(context: Compression, *_: Any) -> None:
        gaussians = context.training.gaussians
        gaussians.keep(torch.arange(gaussians.count // 2, device=gaussians.device))
        raise RuntimeError("too late")

    monkeypatch.setattr(schedule, "prune_unmissed", fails)
    list(run_training(replace(task, lossless=True), trainer_type=Watched))
    scene = read_scene(task.output)
    for name, value in before.items():
        name = name.removeprefix("canonical.").replace("deformation.", "network.")
        np.testing.assert_array_equal(scene.arrays[name], value.numpy())


def test_a_figure_that_no_header_holds_costs_no_scene(task: TrainingJob) -> None:
    class Measured(Trainer):
        def evaluate(self, *_: object) -> tuple[float, str]:
            return float("inf"), "held-out"

    assert isinstance(list(run_training(task, trainer_type=Measured))[-1], events.Finished)
    assert plays(task).header.metrics == {"split": "held-out"}


def test_a_second_saving_does_not_see_the_first(task: TrainingJob, make_trainer: Callable[..., Trainer]) -> None:
    """Building a scene changes neither the figures nor the reductions that it was given."""
    session = Session(task, train(make_trainer(STEPS, capacity="auto")))
    metrics: Metrics = {"psnr": 12.5, "split": "held-out"}
    one, other = (build_scene(session, metrics).scene.header.capacity["reductions"] for _ in range(2))
    assert one and one == other
    assert metrics == {"psnr": 12.5, "split": "held-out"}
