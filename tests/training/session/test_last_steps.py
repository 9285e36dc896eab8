"""What a training does besides learning, and may leave undone: whatever fails there, what was learned plays."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.compression import schedule
from frog_blender.engine.training.compression.passes import silence_heads
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events, export, loop
from frog_blender.engine.training.session.job import TrainingJob, run_training

STEPS = 40
ERRORS = [
    RuntimeError("torch does not like this"),
    np.linalg.LinAlgError("singular matrix"),
    ValueError("cannot convert float NaN to integer\nand more"),
    MemoryError(),
]
AT_THE_END = [
    *((schedule, name) for name in ("mean_dynamic_state", "rest", "narrow", "silence_heads")),
    *((export, name) for name in ("freeze_attributes", "arranged", "compactions", "_capacity")),
    *((loop, name) for name in ("fit_budget", "capacity_image")),
    (Trainer, "evaluate"),
]
ON_THE_WAY = [(schedule, name) for name in ("freeze_static_regions", "wake_some", "prune", "reduce_sh_degree")]


def name_of(value: Any) -> str | None:
    return value[1] if isinstance(value, tuple) else None


@pytest.fixture
def task(filmed: Path, tmp_path: Path, lively: Callable, seeds_at_no_cost: None) -> TrainingJob:
    settings = lively(STEPS, capacity="auto")
    return TrainingJob(filmed, tmp_path / "x.frog", recipe=settings, seed=2, device="cpu")


def broken(monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception) -> None:
    """Lets ``what`` fail; what is done in the middle of a training as well, only at its end."""
    owner, name = what
    real = getattr(owner, name)

    def fails(*arguments: Any, **options: Any) -> Any:
        trainer = next((each for each in arguments if isinstance(each, Trainer)), None)
        if name in ("evaluate", "rest", "_capacity") and trainer is not None and not trainer.finished:
            return real(*arguments, **options)
        raise error

    monkeypatch.setattr(owner, name, fails)


def plays(task: TrainingJob) -> ScenePlayer:
    """The scene that lies where the job wants it, played at some moments."""
    scene = ScenePlayer.load(task.output)
    for moment in (0.0, 0.4, 1.0):
        assert all(np.isfinite(values).all() for values in vars(scene.at(moment)).values())
    return scene


def check(task: TrainingJob, monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception) -> None:
    broken(monkeypatch, what, error)
    stream = list(run_training(task))
    said = [event.message for event in stream if isinstance(event, events.WarningEvent)]
    assert isinstance(stream[-1], events.Finished) and plays(task).header.steps == STEPS
    assert all(message.endswith(".") and "\n" not in message for message in said)
    assert len(said) == (2 if what[1] == "wake_some" else 1)  # which there are two rounds of


@pytest.mark.parametrize(("number", "what"), list(enumerate([*AT_THE_END, *ON_THE_WAY])), ids=name_of)
def test_a_pass_that_fails_costs_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, number: int, what: tuple[Any, str]
) -> None:
    errors = ERRORS if what in AT_THE_END else ERRORS[:3]  # memory that ends in the middle costs Gaussians
    check(task, monkeypatch, what, errors[number % len(errors)])


@pytest.mark.slow
@pytest.mark.parametrize(("what", "error"), list(itertools.product(AT_THE_END, ERRORS)), ids=str)
def test_whatever_fails_at_the_end_costs_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, what: tuple[Any, str], error: Exception
) -> None:
    check(task, monkeypatch, what, error)


def test_what_a_failed_round_did_is_undone(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last thing that it does fails, after a head was silenced and the network narrowed."""
    before: dict[str, Any] = {}

    def worse(rounds: Any, trainer: Trainer, judge: Any, *_: Any) -> None:
        before.update({name: value.clone() for name, value in trainer.model.state_dict().items()})
        before["heads"] = trainer.model.heads
        width = trainer.model.settings.hidden_width
        trainer.optimizer.keep_units(trainer.model, torch.arange(width // 2))

    def fails(_rounds: Any, trainer: Trainer, _judge: Any) -> None:
        trainer.model.prune_head("means")
        raise RuntimeError("too late")

    monkeypatch.setattr(schedule, "rest", lambda *_: None)
    monkeypatch.setattr(schedule, "narrow", worse)
    monkeypatch.setattr(schedule, "silence_heads", fails)
    list(run_training(replace(task, lossless=True)))
    scene = read_scene(task.output)
    assert "means" in before["heads"] and "means" not in scene.header.model["silent_heads"]
    assert scene.header.model["hidden_width"] == task.recipe.hidden_width
    for name, value in before.items():
        if isinstance(value, torch.Tensor):
            name = name.removeprefix("canonical.").replace("deformation.", "network.")
            np.testing.assert_array_equal(scene.arrays[name], value.numpy())
    assert silence_heads is not schedule.silence_heads


def test_a_training_goes_on_after_a_round_that_failed(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, (schedule, "prune"), ValueError("no"))
    stream = list(run_training(task))
    assert isinstance(stream[-1], events.Finished)
    (said,) = [event.message for event in stream if isinstance(event, events.WarningEvent)]
    assert said == "Leaving out what the scene does not need failed (no): nothing was left out at 80 %."
    assert [event.step for event in stream if isinstance(event, events.Evaluated)][-1] == STEPS


def test_a_failing_figure_is_told_as_such(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, (Trainer, "evaluate"), MemoryError("no more"))
    *_, end = run_training(task)
    assert isinstance(end, events.Finished) and end.psnr is None
    assert "psnr" not in plays(task).header.metrics


@pytest.mark.parametrize("figure", [float("nan"), float("inf")])
def test_figures_that_no_header_holds_cost_no_scene(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch, figure: float
) -> None:
    monkeypatch.setattr(Trainer, "evaluate", lambda *_: (figure, "held-out"))
    assert isinstance(list(run_training(task))[-1], events.Finished)
    assert plays(task).header.metrics == {"split": "held-out"}


def test_a_second_saving_does_not_see_the_first(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    """Building a scene changes neither the figures nor the reductions that it was given."""
    trainers: list[Trainer] = []
    real = loop.build_scene
    metrics = {"psnr": 12.5, "split": "held-out"}

    def twice(job: TrainingJob, trainer: Trainer, scale: float, given: dict[str, Any]) -> Any:
        trainers.append(trainer)
        one, other = real(job, trainer, scale, metrics), real(job, trainer, scale, metrics)
        assert one.scene.header.capacity["reductions"] == [
            {**each, "milliseconds": mine["milliseconds"]}
            for each, mine in zip(
                other.scene.header.capacity["reductions"], one.scene.header.capacity["reductions"], strict=True
            )
        ]
        return one

    monkeypatch.setattr(loop, "build_scene", twice)
    list(run_training(task))
    assert trainers and metrics == {"psnr": 12.5, "split": "held-out"}
